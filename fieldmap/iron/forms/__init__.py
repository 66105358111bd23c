"""The two forms of the iron problem, by flux and by potential, with their elements and material laws."""
