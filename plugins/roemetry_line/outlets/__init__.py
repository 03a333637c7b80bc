"""Outlets: whom a line tells what it has measured, a file each."""
