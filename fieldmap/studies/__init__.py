"""Parameter studies: a device with varied keys, solved at sets of currents, with the results as one data set; fits of
its parameters to measurements (`fit_machine`), optimal parameters (`optimise`), and effects of their tolerances
(`analyse_tolerances`).

Depends on: errors, device, iron, maps (recipes), levitation, pydantic, xarray and h5netcdf (the extra `studies`).
"""

from fieldmap.extras import needs

# All modules need scipy, for the solvers of fieldmap.iron. If it is missing, the error is raised here.
with needs("make", "fieldmap.studies"):
    import scipy

    del scipy

from fieldmap.levitation.unknowns import ReadingsFit, Unknown
from fieldmap.studies.design import Carrying, DesignProblem, Limit, Number, Variable
from fieldmap.studies.machine_fit import (
    ComputedReadings,
    FieldReadings,
    Fit,
    InductanceReadings,
    LiftCurrentReadings,
    MachineFit,
    Readings,
    fit_machine,
    read_fit,
)
from fieldmap.studies.many_maps import ManyMaps, generate_many
from fieldmap.studies.opened_maps import open_maps
from fieldmap.studies.optimisation import optimise, solve_problem
from fieldmap.studies.optimum import Check, LimitAtOptimum, NoFeasibleDesign, Optimum, Step
from fieldmap.studies.reading import read_design_problem, read_study
from fieldmap.studies.run import StudyRun, run_study
from fieldmap.studies.study import Linked, Study
from fieldmap.studies.tolerances import (
    NumberSpread,
    Sampled,
    ToleranceAnalysis,
    Uncertain,
    analyse_tolerances,
)

__all__ = [
    "Carrying",
    "Check",
    "ComputedReadings",
    "DesignProblem",
    "FieldReadings",
    "Fit",
    "InductanceReadings",
    "LiftCurrentReadings",
    "Limit",
    "LimitAtOptimum",
    "Linked",
    "MachineFit",
    "ManyMaps",
    "NoFeasibleDesign",
    "Number",
    "NumberSpread",
    "Optimum",
    "Readings",
    "ReadingsFit",
    "Sampled",
    "Step",
    "Study",
    "StudyRun",
    "ToleranceAnalysis",
    "Uncertain",
    "Unknown",
    "Variable",
    "analyse_tolerances",
    "fit_machine",
    "generate_many",
    "open_maps",
    "optimise",
    "read_design_problem",
    "read_fit",
    "read_study",
    "run_study",
    "solve_problem",
]
