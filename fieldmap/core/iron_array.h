/* iron_array.h: a model of saturating iron and what its solves remember in one array, for compiled loops that know nothing
 * but an address.
 *
 * The head of the array holds counts of what was done, which callers may read. Behind it lie the numbers of the model
 * (iron.h), and behind these room for the structures and the memory of a state. They hold addresses: a copy of the array
 * remembers nothing.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_IRON_ARRAY_H
#define FIELDMAP_IRON_ARRAY_H

#include "iron.h"

/* The address of fieldmap_iron_array_weights; solves so far, their Newton steps, those that did not converge, those of
 * currents beyond the domain; tolerance of a solve; how many numbers the model has. */
enum {
    FIELDMAP_ARRAY_ADDRESS = 0, FIELDMAP_ARRAY_SOLVES = 2, FIELDMAP_ARRAY_NEWTON_STEPS = 3, FIELDMAP_ARRAY_UNSOLVED = 4,
    FIELDMAP_ARRAY_OUTSIDE = 5, FIELDMAP_ARRAY_TOLERANCE = 6, FIELDMAP_ARRAY_COUNT = 7, FIELDMAP_ARRAY_HEAD = 12
};

typedef struct fieldmap_iron_pair {
    fieldmap_iron model;
    fieldmap_iron_state state;
} fieldmap_iron_pair;

/* What lies behind the numbers, at a multiple of 64 bytes. */
static inline fieldmap_iron_pair *fieldmap_iron_array_pair(double *array)
{
    const uintptr_t behind = (uintptr_t)(array + FIELDMAP_ARRAY_HEAD + (size_t)array[FIELDMAP_ARRAY_COUNT]);
    return (fieldmap_iron_pair *)((behind + 63) / 64 * 64);
}

static inline size_t fieldmap_iron_array_of_pair(void)
{
    return (sizeof(fieldmap_iron_pair) + 63) / 64 * 64;
}

/* How long the array of a model of `count` numbers is. */
static inline size_t fieldmap_iron_array_length(const fieldmap_iron *model, size_t count)
{
    const size_t bytes = 64 + fieldmap_iron_array_of_pair() + fieldmap_iron_memory(model);
    return FIELDMAP_ARRAY_HEAD + count + (bytes + sizeof(double) - 1) / sizeof(double);
}

/* Nothing is remembered yet. Currents beyond the domain are solved, too. */
static inline int fieldmap_iron_array_begin(double *array)
{
    fieldmap_iron_pair *pair = fieldmap_iron_array_pair(array);
    int status = fieldmap_iron_of_numbers(
        &pair->model, array + FIELDMAP_ARRAY_HEAD, (uint64_t)array[FIELDMAP_ARRAY_COUNT]);
    if (status != FIELDMAP_OK) return status;
    pair->model.checked = 0;
    return fieldmap_iron_start(&pair->state, &pair->model, (unsigned char *)pair + fieldmap_iron_array_of_pair(),
                               fieldmap_iron_memory(&pair->model));
}

/* weights[n_fields] at currents[n_coils]. A solve that begins from the last states and fails begins anew; where that fails
 * too, the iron stays as it was last. NaN for currents that are not finite. The status of the solve. */
static inline int fieldmap_iron_array_weights(double *array, const double *currents, double *weights)
{
    fieldmap_iron_pair *pair = fieldmap_iron_array_pair(array);
    fieldmap_iron_state *state = &pair->state;
    double signals[FIELDMAP_IRON_MAX_SIGNALS], zero = 0.0;
    int status, f;
    /* In a copy the addresses are those of the array that it was copied from. */
    if (state->map != &pair->model && (status = fieldmap_iron_array_begin(array)) != FIELDMAP_OK) return status;
    status = fieldmap_iron_solve_at(state, currents, array[FIELDMAP_ARRAY_TOLERANCE]);
    array[FIELDMAP_ARRAY_SOLVES] += 1.0;
    array[FIELDMAP_ARRAY_NEWTON_STEPS] += state->steps;
    if (status == FIELDMAP_IRON_NOT_CONVERGED) {
        status = fieldmap_iron_solve_at(state, currents, array[FIELDMAP_ARRAY_TOLERANCE]);
        array[FIELDMAP_ARRAY_NEWTON_STEPS] += state->steps;
    }
    array[FIELDMAP_ARRAY_UNSOLVED] += status != FIELDMAP_OK;
    array[FIELDMAP_ARRAY_OUTSIDE] += !fieldmap_iron_signals(&pair->model, currents, signals);
    for (f = 0; f < pair->model.n_fields; f++) {
        weights[f] = f < pair->model.n_coils ? currents[f] : state->solution[f];
        if (status == FIELDMAP_NOT_FINITE) weights[f] = zero / zero;
    }
    return status;
}

#endif
