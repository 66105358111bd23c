"""What a machine is, and the file that describes it."""
