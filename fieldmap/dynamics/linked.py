"""The older name of `fieldmap.dynamics.coupled`."""

from fieldmap.deprecated import renamed

_COUPLED = "fieldmap.dynamics.coupled:"
_SAME = (
    "ForceController",
    "ScheduledController",
    "Trajectory",
    "feedforward",
    "force_controller",
    "outputs_for",
    "trajectory",
)

__getattr__ = renamed(
    __name__,
    {name: _COUPLED + name for name in _SAME}
    | {"GaussianWeights": f"{_COUPLED}LqgWeights", "gaussian_block": f"{_COUPLED}lqg_block"},
)
