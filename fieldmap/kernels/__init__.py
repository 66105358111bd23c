"""Compiled loops: arrays in, arrays out. No classes, no strings, no user errors; checked functions stand in front."""
