"""The older name of `fieldmap.dynamics.linearisation`."""

from fieldmap.deprecated import renamed

_LINEARISATION = "fieldmap.dynamics.linearisation:"
_LOOP = "fieldmap.dynamics.linear_loop:"
_SAME = ("Coupling", "LinearMachine", "Mode", "coupling", "linearise", "modes", "moved_state")
_OF_LOOP = (
    "ClosedLoop",
    "Margins",
    "SampledMachine",
    "close_loop",
    "margins",
    "sampled_machine",
    "sensor_answer",
)

__getattr__ = renamed(
    __name__,
    {name: _LINEARISATION + name for name in _SAME}
    | {name: _LOOP + name for name in _OF_LOOP}
    | {"Reach": f"{_LINEARISATION}Controllability", "reach": f"{_LINEARISATION}controllability"},
)
