"""Parameter studies: a device with some keys varied, solved at sets of currents, and what comes out as one data set.

Depends on: errors, device, iron, maps (recipes), levitation, pydantic, xarray and h5netcdf (the extra `studies`).
"""

from fieldmap.studies.reading import read_study
from fieldmap.studies.run import StudyRun, run_study
from fieldmap.studies.study import Study

__all__ = ["Study", "StudyRun", "read_study", "run_study"]
