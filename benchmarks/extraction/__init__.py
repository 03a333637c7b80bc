"""What extractors are judged by: drawn images, the bound physics sets, scoring, other people's methods."""
