"""What a solved state says: field in the air and inside, forces, linkages."""
