"""Hostile input: files and arguments with random mistakes, and the outcomes of reading them."""
