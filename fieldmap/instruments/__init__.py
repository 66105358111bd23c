"""What stands between a machine and its controller: sensor frames, micrometers, converters, amplifiers, noise.

Each instrument is a frozen set of data-sheet numbers; functions turn it into a calculator (what accuracy to expect)
or a block of a simulation (what the controller sees), with noise from a seeded `numpy.random.Generator`.
Depends on: errors, kernels. Knows no particular card or rig: their numbers are the user's.
"""

from fieldmap.instruments.frames import SensorFrame

__all__ = ["SensorFrame"]
