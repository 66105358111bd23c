"""Hostile input: files and arguments with mistakes made at random, and what readers make of them."""
