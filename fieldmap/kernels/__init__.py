"""Compiled loops: arrays in, arrays out. No classes, no strings, no user errors; the callers check the arguments."""
