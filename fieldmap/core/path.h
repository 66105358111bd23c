/* path.h: a map's field at points that move little from call to call.
 *
 * The coefficients of a point's cell are summed over the sets of the map once, and kept until its cell or the weights change.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PATH_H
#define FIELDMAP_PATH_H

#include "map.h"

/* weights: one for each set of the map; call fieldmap_path_forget() after a change. rows: sums of each point,
 * fieldmap_path_row() numbers; places: cell of these sums for each point, or -1 for none. If places is NULL, nothing is
 * kept. */
typedef struct fieldmap_path {
    const fieldmap *map;
    const fm_real *weights;
    int points;
    int64_t *places;
    fm_real *rows;
} fieldmap_path;

/* Numbers that are kept for a point. */
static inline int fieldmap_path_row(const fieldmap *map)
{
    return map->kind == FIELDMAP_HERMITE ? 8 * FIELDMAP_NODE : map->size;
}

/* Drop all sums, after a change of the weights. */
static inline void fieldmap_path_forget(const fieldmap_path *path)
{
    int p;
    for (p = 0; p < path->points; p++) path->places[p] = -1;
}

/* The number of a cell of a map. */
FIELDMAP_INLINE int64_t fieldmap_cell_number(const fieldmap *map, const fieldmap_spot *spot)
{
    return ((int64_t)spot->cell[0] * map->cells[1] + spot->cell[1]) * map->cells[2] + spot->cell[2];
}

/* flux[3] and gradient[9] for point number p at a place. */
FIELDMAP_INLINE int fieldmap_path_field(const fieldmap_path *path, int p, const fm_real *point, fm_real *flux, fm_real *gradient)
{
    const fieldmap *map = path->map;
    fieldmap_spot spot;
    const int status = fieldmap_locate(map, point, &spot);
    const int64_t place = fieldmap_cell_number(map, &spot);
    fm_real *row;
    if (status != FIELDMAP_OK) return status;
    if (path->places == NULL) {
        fieldmap_field_at(map, path->weights, &spot, flux, gradient);
        return status;
    }
    row = path->rows + (size_t)p * (size_t)fieldmap_path_row(map);
    if (path->places[p] != place) {
        fieldmap_gather(map, path->weights, &spot, row);
        path->places[p] = place;
    }
    fieldmap_field_of_row(map, row, &spot, flux, gradient);
    return status;
}

#endif
