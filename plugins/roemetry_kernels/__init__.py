"""Compiled kernels that several plugins share: a library that registers nothing."""
