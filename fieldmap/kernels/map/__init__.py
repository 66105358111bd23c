"""Reduced models of saturating iron, solved while they are trained."""
