/* block.h: a map in one array of double-precision numbers: a header, then the coefficients.
 *
 * Python holds maps in this form, and so do files for C (map_file.h). Integers are stored as reals.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_BLOCK_H
#define FIELDMAP_BLOCK_H

#include "map.h"

/* Indices of the header: kind; whether points outside are clamped; number of sets; degree; lower corner, m; 1 / spacing, 1/m;
 * cells along each axis; spacing divided by the unit of length; that unit, m, and its inverse. Only files use the others:
 * whether the last set is a field that no current drives; number of sets of the iron's reaction to magnets, which follow all
 * other sets; how many of these, the last ones, have the sign -1; number of coils whose inductances, then constant linkages,
 * end the block. */
enum {
    FIELDMAP_KIND = 0, FIELDMAP_CLAMPS = 1, FIELDMAP_SETS = 2, FIELDMAP_DEGREE = 3, FIELDMAP_LOWER = 4,
    FIELDMAP_INVERSE = 7, FIELDMAP_CELLS = 10, FIELDMAP_LOCAL = 13, FIELDMAP_LENGTH = 16, FIELDMAP_PER_LENGTH = 17,
    FIELDMAP_CONSTANT = 18, FIELDMAP_REACTING = 19, FIELDMAP_REPELLED = 20, FIELDMAP_LINKED = 21,
    FIELDMAP_HEADER = 24
};

/* The integer from low to high that a number stores, or -1 if it stores none. NaN fails every comparison. */
static inline long fieldmap_whole(double value, long low, long high)
{
    long whole;
    if (!(value >= (double)low && value <= (double)high)) return -1;
    whole = (long)value;
    return (double)whole == value ? whole : -1;
}

/* Fill a map from a block of `count` numbers, which must outlive the map. components: of a Hermite form, 3 for flux density or
 * 1 for the potential. Returns FIELDMAP_DAMAGED unless the header is valid and its sizes agree with `count`. */
static inline int fieldmap_of_block(fieldmap *map, const double *block, uint64_t count, int components)
{
    long kind, degree, sets, size;
    uint64_t left;
    int axis, nodes;
    map->coefficients = NULL;
    map->reaction = NULL;
    map->reacting = map->repelled = map->linkage.coils = 0;
    if (count < FIELDMAP_HEADER) return FIELDMAP_DAMAGED;
    kind = fieldmap_whole(block[FIELDMAP_KIND], FIELDMAP_HERMITE, FIELDMAP_GLOBAL);
    sets = fieldmap_whole(block[FIELDMAP_SETS], 1, 1000000);
    if (kind < 0 || sets < 0 || fieldmap_whole(block[FIELDMAP_CLAMPS], 0, 1) < 0) return FIELDMAP_DAMAGED;
    nodes = kind == FIELDMAP_HERMITE;
    degree = fieldmap_whole(block[FIELDMAP_DEGREE], nodes ? 0 : 3, FIELDMAP_MAX_DEGREE);
    if (degree < 0) return FIELDMAP_DAMAGED;
    size = nodes ? FIELDMAP_CORNER * components : (degree + 1) * (degree + 1);
    left = (count - FIELDMAP_HEADER) / (uint64_t)(size * sets);
    if (left * (uint64_t)(size * sets) != count - FIELDMAP_HEADER) return FIELDMAP_DAMAGED;
    for (axis = 0; axis < 3; axis++) {
        const long cells = fieldmap_whole(block[FIELDMAP_CELLS + axis], 1, 1000000);
        const double inverse = block[FIELDMAP_INVERSE + axis], lower = block[FIELDMAP_LOWER + axis];
        const double local = block[FIELDMAP_LOCAL + axis];
        if (cells < 0 || left % (uint64_t)(cells + nodes) != 0) return FIELDMAP_DAMAGED;
        left /= (uint64_t)(cells + nodes);
        if (!(inverse > 0.0 && local > 0.0 && inverse - inverse == 0.0 && lower - lower == 0.0)) return FIELDMAP_DAMAGED;
        if (kind == FIELDMAP_GLOBAL && cells != 1) return FIELDMAP_DAMAGED;
        map->cells[axis] = (int)cells;
        map->lower[axis] = (fm_real)lower;
        map->upper[axis] = (fm_real)(lower + (double)cells / inverse);
        map->inverse[axis] = (fm_real)inverse;
        map->local[axis] = (fm_real)local;
    }
    map->kind = (int)kind;
    map->clamps = block[FIELDMAP_CLAMPS] == 1.0;
    map->degree = (int)degree;
    map->size = (int)size;
    map->n_coils = (int)sets;
    map->constant = 0;
    map->per_length = (fm_real)block[FIELDMAP_PER_LENGTH];
    /* Builds with another type of `real` have their coefficients as constants, not in a block. */
    if (sizeof(fm_real) == sizeof(double)) map->coefficients = (const fm_real *)(const void *)(block + FIELDMAP_HEADER);
    return left == 1 && map->coefficients != NULL ? FIELDMAP_OK : FIELDMAP_DAMAGED;
}

#endif
