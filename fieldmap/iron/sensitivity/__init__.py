"""Derivatives of a solved state's quantities by the numbers of its device, by the adjoint of the discrete equations.

Depends on: errors, records, device, sources, kernels, and all of iron below the solvers.
"""
