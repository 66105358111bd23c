"""Training of the current dependence: from solved states to a reduced model that evaluates the B-H law itself."""
