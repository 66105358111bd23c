"""The older name of `fieldmap.dynamics.linearisation`."""

from fieldmap.deprecated import renamed

_LINEARISATION = "fieldmap.dynamics.linearisation:"
_SAME = (
    "ClosedLoop",
    "Coupling",
    "LinearMachine",
    "Margins",
    "Mode",
    "SampledMachine",
    "close_loop",
    "coupling",
    "linearise",
    "margins",
    "modes",
    "moved_state",
    "sampled_machine",
    "sensor_answer",
)

__getattr__ = renamed(
    __name__,
    {name: _LINEARISATION + name for name in _SAME}
    | {"Reach": f"{_LINEARISATION}Controllability", "reach": f"{_LINEARISATION}controllability"},
)
