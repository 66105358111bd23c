"""Compiled field integrals of windings: arcs, bars, rings, sheets and loops."""
