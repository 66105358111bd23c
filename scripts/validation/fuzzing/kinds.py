"""All kinds of input for fuzzing."""

from validation.fuzzing import hdf5_kinds, python_kind, solid_kinds, table_kinds, toml_kinds, unit_kind
from validation.fuzzing.case import Kind

KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        toml_kinds.DEVICES,
        toml_kinds.RECIPES,
        toml_kinds.SCENARIOS,
        toml_kinds.STUDIES,
        toml_kinds.OPTIMISATIONS,
        toml_kinds.FITS,
        toml_kinds.PLANAR,
        toml_kinds.CURVES,
        toml_kinds.EXPRESSIONS,
        hdf5_kinds.MAPS,
        hdf5_kinds.RUNS,
        table_kinds.READINGS,
        table_kinds.LOGS,
        table_kinds.VECTOR_FIELDS,
        solid_kinds.SURFACES,
        solid_kinds.MESHES,
        solid_kinds.STEPS,
        unit_kind.UNITS,
        python_kind.MACHINES,
    )
}
