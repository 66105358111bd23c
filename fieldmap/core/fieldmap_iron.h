/* fieldmap_iron.h: field, gradient, wrench and actuation of coils with saturating iron at any currents, in C99.
 *
 * The map is a file that `fieldmap export MAP --to c -o iron.fmap` writes from a map of saturating iron; docs/c.md has an
 * example. It holds the fields of the coils and of the iron, as fieldmap.h reads them, and the model that turns currents into
 * their weights (docs/theory/current_dependence.md). The caller gives the memory of a solver state, fieldmap_iron_memory()
 * bytes for each thread; only fieldmap_iron_open allocates. A solve takes at most FIELDMAP_IRON_STEPS steps. Successive calls
 * with equal currents solve once.
 *
 * Iron with hysteresis depends on earlier currents. A state begins with the memory that the file has. fieldmap_iron_step goes
 * straight to new currents, and the iron remembers this path. The other functions return results after such a path, but the
 * iron does not remember it. fieldmap_iron_copy stores and restores a memory.
 *
 * Every function returns FIELDMAP_OK, or an error status of fieldmap.h or iron.h with results of NaN.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_IRON_H
#define FIELDMAP_IRON_H

#include "fieldmap.h"
#include "flux_linkage.h"

/* Text of a status. */
static inline const char *fieldmap_iron_message(int status)
{
    switch (status) {
    case FIELDMAP_IRON_BEYOND: return "currents outside the domain that the map was made for";
    case FIELDMAP_IRON_NOT_CONVERGED: return "Newton's method did not converge";
    case FIELDMAP_IRON_MEMORY: return "memory of the state is too small, or not at a multiple of 64";
    default: return fieldmap_message(status);
    }
}

/* Use a map in memory, for example in flash, without a copy: `bytes`, at an address that is a multiple of 8, must outlive the
 * map. Nothing is allocated. */
static inline int fieldmap_iron_view(fieldmap_iron *map, const void *bytes, size_t size)
{
    const unsigned char *raw = (const unsigned char *)bytes;
    const double *numbers;
    fieldmap_iron_state none;
    uint32_t version, remembered;
    uint64_t count, most;
    int status;
    if (map == NULL || bytes == NULL) return FIELDMAP_ARGUMENT;
    memset(map, 0, sizeof *map);
    status = fieldmap_check_file(bytes, size, "fmapiron", FIELDMAP_NAMES + 8 * FIELDMAP_IRON_SIZES, 2u, &version);
    if (status != FIELDMAP_OK) return status;
    memcpy(&remembered, raw + 28, 4);
    memcpy(&count, raw + 32, 8);
    most = (size - FIELDMAP_NAMES) / 8;
    if (count > most || remembered > most - count) return FIELDMAP_DAMAGED;
    numbers = (const double *)(const void *)(raw + FIELDMAP_NAMES);
    status = fieldmap_iron_of_numbers(map, numbers, count);
    if (status == FIELDMAP_OK && (map->n_coils < 1 || (map->n_cells > 0) != (version == 2u))) status = FIELDMAP_DAMAGED;
    if (status == FIELDMAP_OK && map->n_cells > 0) {
        memset(&none, 0, sizeof none);
        none.map = map;
        map->remembered = numbers + count;
        if (remembered != fieldmap_iron_copy(&none, NULL, NULL)) status = FIELDMAP_DAMAGED;
    }
    count += remembered;
    if (status == FIELDMAP_OK)
        status = fieldmap_view(&map->fields, numbers + count, size - FIELDMAP_NAMES - 8 * (size_t)count);
    if (status == FIELDMAP_OK && (map->fields.n_coils != map->n_fields || map->fields.constant)) status = FIELDMAP_DAMAGED;
    if (status == FIELDMAP_OK && map->fields.linkage.coils != 0 && map->fields.linkage.coils != map->n_coils)
        status = FIELDMAP_DAMAGED;
    if (status != FIELDMAP_OK) memset(map, 0, sizeof *map);
    return status;
}

/* Free the memory of fieldmap_iron_open. */
static inline void fieldmap_iron_close(fieldmap_iron *map)
{
    if (map != NULL) {
        free(map->owned);
        memset(map, 0, sizeof *map);
    }
}

/* Read a map from a file. */
static inline int fieldmap_iron_open(fieldmap_iron *map, const char *path)
{
    void *bytes;
    size_t size = 0;
    int status;
    if (map == NULL || path == NULL) return FIELDMAP_ARGUMENT;
    memset(map, 0, sizeof *map);
    status = fieldmap_read_file(path, &bytes, &size);
    if (status == FIELDMAP_OK) status = fieldmap_iron_view(map, bytes, size);
    if (status == FIELDMAP_OK)
        map->owned = bytes;
    else
        free(bytes);
    return status;
}

/* flux[3] and, unless NULL, gradient[9] at point[3] for currents[n_coils]. */
static inline int fieldmap_iron_field(
    fieldmap_iron_state *state, const double *currents, const double *point, double *flux, double *gradient)
{
    int i, status;
    if (state == NULL || state->map == NULL || currents == NULL || flux == NULL) return FIELDMAP_ARGUMENT;
    status = fieldmap_iron_solve_at(state, currents, state->tolerance);
    if (status == FIELDMAP_OK) return fieldmap_field(&state->map->fields, state->solution, point, flux, gradient);
    for (i = 0; i < 3; i++) flux[i] = (double)NAN;
    for (i = 0; i < 9 && gradient != NULL; i++) gradient[i] = (double)NAN;
    return status;
}

/* wrench[6] on a dipole of moment[3] at point[3]. */
static inline int fieldmap_iron_wrench(
    fieldmap_iron_state *state, const double *currents, const double *point, const double *moment, double *wrench)
{
    int i, status;
    if (state == NULL || state->map == NULL || currents == NULL || wrench == NULL) return FIELDMAP_ARGUMENT;
    status = fieldmap_iron_solve_at(state, currents, state->tolerance);
    if (status == FIELDMAP_OK) return fieldmap_wrench(&state->map->fields, state->solution, point, moment, wrench);
    for (i = 0; i < 6; i++) wrench[i] = (double)NAN;
    return status;
}

/* Numbers of room that fieldmap_iron_flux_linkage needs. */
static inline size_t fieldmap_iron_linkage_room(const fieldmap_iron *map)
{
    return (size_t)map->n_fields * (2 + (size_t)map->n_coils);
}

/* Fill linkages[n_coils], Wb, of coils and iron at currents[n_coils], and of a dipole of moment[3] at point[3], unless both are
 * NULL. Fill, unless NULL, inductance[n_coils * n_coils], H: the derivatives of the linkages without the dipole. */
static inline int fieldmap_iron_flux_linkage(fieldmap_iron_state *state, const double *currents, const double *point,
                                             const double *moment, double *room, double *linkages, double *inductance)
{
    double *along = room, *weights, *slopes;
    int f, n, fields, status;
    if (state == NULL || state->map == NULL || currents == NULL || room == NULL || linkages == NULL
        || (point == NULL) != (moment == NULL))
        return FIELDMAP_ARGUMENT;
    n = state->map->n_coils, fields = state->map->n_fields;
    if (state->map->fields.linkage.coils != n) return FIELDMAP_UNLINKED;
    weights = along + fields, slopes = weights + fields;
    for (f = 0; f < fields; f++) along[f] = 0.0;
    status = fieldmap_solve_linkages(state, &state->map->fields.linkage, currents, weights, slopes, linkages, inductance);
    if (status != FIELDMAP_OK || point == NULL) return status;
    status = fieldmap_add_along(&state->map->fields, point, moment, along);
    if (status == FIELDMAP_OK) fieldmap_add_payload_linkages(n, fields, along, slopes, linkages);
    else fieldmap_unknown(linkages, n);
    return status;
}

#endif
