"""Parameter studies: a device with some keys varied, solved at sets of currents, and what comes out as one data set;
and numbers of a machine that are found from measurements on it (`fit_machine`).

Depends on: errors, device, iron, maps (recipes), levitation, pydantic, xarray and h5netcdf (the extra `studies`).
"""

from fieldmap.studies.machine_fit import (
    ComputedReadings,
    FieldReadings,
    InductanceReadings,
    LiftCurrentReadings,
    MachineFit,
    Readings,
    ReadingsFit,
    Unknown,
    fit_machine,
)
from fieldmap.studies.reading import read_study
from fieldmap.studies.run import StudyRun, run_study
from fieldmap.studies.study import Study

__all__ = [
    "ComputedReadings",
    "FieldReadings",
    "InductanceReadings",
    "LiftCurrentReadings",
    "MachineFit",
    "Readings",
    "ReadingsFit",
    "Study",
    "StudyRun",
    "Unknown",
    "fit_machine",
    "read_study",
    "run_study",
]
