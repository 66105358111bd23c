/* python_iron.h: models of saturating iron, for Python: see fieldmap.core.iron.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_IRON_H
#define FIELDMAP_PYTHON_IRON_H

#include <limits.h>

#include "iron.h"
#include "python_reader.h"

static const char *const IRON = "fieldmap.core.iron";
/* The state of the solves of one thread. */
static const char *const STATE = "fieldmap.core.iron_state";

static void read_iron(reader *from, void *out)
{
    const number_array given = numbers_of(from, "numbers", 1, ANY);
    if (given.at == NULL) return;
    require(fieldmap_iron_of_numbers((fieldmap_iron *)out, given.at, (uint64_t)given.size) == FIELDMAP_OK, PyExc_ValueError,
            "numbers are not those of a model of iron");
}

/* iron_of_numbers(numbers): see fieldmap.core.iron. */
static PyObject *iron_of_numbers(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = kept_arguments(args, given, 1);
    (void)self;
    return held(&from, IRON, sizeof(fieldmap_iron), read_iron);
}

static void read_state(reader *from, void *out)
{
    const fieldmap_iron *iron = (const fieldmap_iron *)held_of(from, "iron", IRON);
    const size_t size = iron == NULL ? 0 : fieldmap_iron_memory(iron);
    void *memory = memory_of(from, size);
    if (memory != NULL) fieldmap_iron_start((fieldmap_iron_state *)out, iron, memory, size);
}

/* iron_state(iron) */
static PyObject *iron_state(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = kept_arguments(args, given, 1);
    (void)self;
    return held(&from, STATE, sizeof(fieldmap_iron_state), read_state);
}

/* iron_solve(state, currents, tolerance, checked, fresh, weights, slopes): the status. */
static PyObject *iron_solve(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 7);
    fieldmap_iron_state *state = (fieldmap_iron_state *)held_of(&from, "state", STATE);
    const int coils = state == NULL ? 0 : state->map->n_coils, fields = state == NULL ? 0 : state->map->n_fields;
    const double *currents = numbers_of(&from, "currents", 1, coils).at, tolerance = real_of(&from, "tolerance");
    const int checked = truth_of(&from, "checked"), fresh = truth_of(&from, "fresh");
    double *weights = filled_of(&from, "weights", fields);
    double *slopes = filled_or_none(&from, "slopes", (npy_intp)fields * coils);
    int status;
    (void)self;
    if (PyErr_Occurred()) return NULL;
    state->tolerance = tolerance, state->checked = checked;
    if (fresh) state->count = 0;
    Py_BEGIN_ALLOW_THREADS
    status = slopes == NULL ? fieldmap_iron_weights(state, currents, weights)
                            : fieldmap_iron_slopes(state, currents, weights, slopes);
    Py_END_ALLOW_THREADS
    return PyLong_FromLong(status);
}

/* iron_linkages(state, currents, tolerance, fresh, linkages, inductance): the status; results times mu0; inductance may be
 * None. */
static PyObject *iron_linkages(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 6);
    fieldmap_iron_state *state = (fieldmap_iron_state *)held_of(&from, "state", STATE);
    const int coils = state == NULL ? 0 : state->map->n_coils, fields = state == NULL ? 0 : state->map->n_fields;
    const double *currents = numbers_of(&from, "currents", 1, coils).at, tolerance = real_of(&from, "tolerance");
    const int fresh = truth_of(&from, "fresh");
    double *linkages = filled_of(&from, "linkages", coils);
    double *inductance = filled_or_none(&from, "inductance", (npy_intp)coils * coils);
    /* Only slopes need room, for the weights and their derivatives. */
    const size_t room = inductance == NULL ? 1 : (size_t)(fields * (1 + coils));
    double *weights = (double *)memory_of(&from, room * sizeof(double));
    int k, status;
    (void)self;
    if (PyErr_Occurred()) return answer(&from, NULL);
    state->tolerance = tolerance, state->checked = 0;
    if (fresh) state->count = 0;
    Py_BEGIN_ALLOW_THREADS
    if (inductance != NULL) {
        status = fieldmap_iron_linked_slopes(state, currents, weights, weights + fields, linkages, inductance);
    } else {
        status = fieldmap_iron_solve_at(state, currents, tolerance);
        if (status == FIELDMAP_OK) fieldmap_iron_linkages(state, linkages);
    }
    for (k = 0; k < coils && status != FIELDMAP_OK; k++) linkages[k] = (double)NAN;
    Py_END_ALLOW_THREADS
    return answer(&from, PyLong_FromLong(status));
}

/* iron_step(state, currents, tolerance, weights): the status; the cells then remember the new state. */
static PyObject *iron_step(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 4);
    fieldmap_iron_state *state = (fieldmap_iron_state *)held_of(&from, "state", STATE);
    const int fields = state == NULL ? 0 : state->map->n_fields;
    const double *currents = numbers_of(&from, "currents", 1, state == NULL ? 0 : state->map->n_coils).at;
    const double tolerance = real_of(&from, "tolerance");
    double *weights = filled_of(&from, "weights", fields);
    int f, status;
    (void)self;
    if (PyErr_Occurred()) return NULL;
    state->tolerance = tolerance, state->checked = 0;
    Py_BEGIN_ALLOW_THREADS
    status = fieldmap_iron_step(state, currents);
    for (f = 0; f < fields; f++) weights[f] = status == FIELDMAP_OK ? state->solution[f] : (double)NAN;
    Py_END_ALLOW_THREADS
    return PyLong_FromLong(status);
}

/* iron_remembered(state): the numbers on which later solves and steps depend. */
static PyObject *iron_remembered(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 1);
    fieldmap_iron_state *state = (fieldmap_iron_state *)held_of(&from, "state", STATE);
    PyObject *numbers;
    double *out;
    (void)self;
    if (state == NULL) return NULL;
    numbers = new_array(1, (npy_intp)fieldmap_iron_copy(state, NULL, NULL), 0, &out);
    if (numbers != NULL) fieldmap_iron_copy(state, out, NULL);
    return numbers;
}

/* iron_recall(state, numbers): restore a memory of `iron_remembered`. */
static PyObject *iron_recall(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 2);
    fieldmap_iron_state *state = (fieldmap_iron_state *)held_of(&from, "state", STATE);
    const npy_intp size = state == NULL ? 0 : (npy_intp)fieldmap_iron_copy(state, NULL, NULL);
    const double *numbers = numbers_of(&from, "numbers", 1, size).at;
    (void)self;
    if (PyErr_Occurred()) return NULL;
    fieldmap_iron_copy(state, NULL, numbers);
    Py_RETURN_NONE;
}

/* iron_solve_in(state, applied, amplitudes, tolerance): the status; amplitudes (r,) hold the first guess, then the result. */
static PyObject *iron_solve_in(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 4);
    fieldmap_iron_state *state = (fieldmap_iron_state *)held_of(&from, "state", STATE);
    const double *applied = numbers_of(&from, "applied", 1, state == NULL ? 0 : 3 * (npy_intp)state->map->p).at;
    double *amplitudes = filled_of(&from, "amplitudes", state == NULL ? 0 : state->map->r);
    const double tolerance = real_of(&from, "tolerance");
    int status;
    (void)self;
    if (PyErr_Occurred()) return NULL;
    Py_BEGIN_ALLOW_THREADS
    status = fieldmap_iron_solve_in(state, applied, amplitudes, tolerance);
    Py_END_ALLOW_THREADS
    return PyLong_FromLong(status);
}

/* iron_amplitudes(state): amplitudes (r,) of the last state, the error of its solve, and the number of steps. */
static PyObject *iron_amplitudes(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 1);
    const fieldmap_iron_state *state = (const fieldmap_iron_state *)held_of(&from, "state", STATE);
    PyObject *amplitudes;
    double *out;
    (void)self;
    if (state == NULL) return NULL;
    amplitudes = new_array(1, state->map->r, 0, &out);
    if (amplitudes == NULL) return NULL;
    memcpy(out, state->amplitudes + (FIELDMAP_IRON_PASSED - 1) * state->map->r, (size_t)state->map->r * sizeof(double));
    return Py_BuildValue("(Ndi)", amplitudes, state->left_over, state->steps);
}

/* iron_continued(aim, passed, amplitudes): amplitudes from which a solve begins after n states. */
static PyObject *iron_continued(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 3);
    const number_array aim = numbers_of(&from, "aim", 1, ANY), passed = numbers_of(&from, "passed", 2, ANY);
    const number_array amplitudes = numbers_of(&from, "amplitudes", 2, ANY);
    const npy_intp n = passed.shape[0], coils = aim.size, modes = amplitudes.shape[1];
    fieldmap_iron model = {0};
    fieldmap_iron_state state = {0};
    PyObject *found = NULL;
    double *out;
    (void)self;
    require(n >= 1 && n <= FIELDMAP_IRON_PASSED && passed.shape[1] == coils && amplitudes.shape[0] == n, PyExc_TypeError,
            "passed (n, c) and amplitudes (n, r) must be of 1 to 3 states");
    model.n_coils = (int)coils, model.r = (int)modes, state.map = &model, state.count = (int)n;
    state.currents = (double *)memory_of(&from, (size_t)(FIELDMAP_IRON_PASSED * (coils + modes)) * sizeof(double));
    if (state.currents != NULL) found = new_array(1, modes, 0, &out);
    if (found != NULL) {
        state.amplitudes = state.currents + FIELDMAP_IRON_PASSED * coils;
        memcpy(state.currents + (FIELDMAP_IRON_PASSED - n) * coils, passed.at, (size_t)passed.size * sizeof(double));
        memcpy(state.amplitudes + (FIELDMAP_IRON_PASSED - n) * modes, amplitudes.at, (size_t)amplitudes.size * sizeof(double));
        fieldmap_iron_continue(&model, &state, aim.at, out);
    }
    return answer(&from, found);
}

/* cells_respond(begin, end, of, h, before, polarisation, after, susceptibility): fill rows begin..end of the last three; of: a
 * PlayCells of fieldmap.core.play_cells. */
static PyObject *cells_respond(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 8);
    const long begin = whole_of(&from, "begin"), end = whole_of(&from, "end");
    reader of = part_of(&from, "of");
    const number_array law = numbers_of(&of, "law", 1, ANY), offset = numbers_of(&of, "offset", 1, ANY);
    const number_array knots = numbers_of(&of, "knots", 1, ANY), shares = numbers_of(&of, "shares", 1, ANY);
    const npy_intp points = law.size, cells = shares.size, laws = offset.size - 1;
    const double *coefficients = numbers_of(&of, "coefficients", 2, 4 * knots.size).at;
    const double *pinning = numbers_of(&of, "pinning", 2, laws * cells).at;
    const double *h = numbers_of(&from, "h", 2, 3 * points).at, *before = numbers_of(&from, "before", 3, 4 * points * cells).at;
    double *j = filled_of(&from, "polarisation", 3 * points), *after = filled_or_none(&from, "after", 4 * points * cells);
    double *susceptible = filled_or_none(&from, "susceptibility", 6 * points);
    fieldmap_iron iron = {0};
    fieldmap_cell_lanes moving;
    npy_intp n;
    (void)self;
    require(0 <= begin && begin <= end && end <= points && points <= INT_MAX && laws >= 1, PyExc_TypeError,
            "begin and end must be rows, of points that follow one of the laws");
    if (PyErr_Occurred()) return answer(&from, NULL);
    iron.p = (int)points, iron.n_laws = (int)laws, iron.n_knots = (int)knots.size;
    iron.law = law.at, iron.offset = offset.at, iron.knots = knots.at, iron.coefficients = coefficients;
    require(fieldmap_iron_laws_fit(&iron, (int)begin, (int)end), PyExc_ValueError, "a point follows no law");
    if (PyErr_Occurred()) return answer(&from, NULL);
    Py_BEGIN_ALLOW_THREADS
    moving.count = 0, moving.heat = 0.0;
    for (n = begin; n < end; n++) {
        const fieldmap_iron_curve curve = fieldmap_iron_curve_of(&iron, (int)n);
        fieldmap_cells_add(&moving, &curve, NULL, (int)cells, pinning + (npy_intp)law.at[n] * cells, shares.at, 1.0, h + 3 * n,
            before + 4 * cells * n, j + 3 * n, after == NULL ? NULL : after + 4 * cells * n,
            susceptible == NULL ? NULL : susceptible + 6 * n);
    }
    fieldmap_cells_finish(&moving);
    Py_END_ALLOW_THREADS
    return nothing(&from);
}

#define IRON_FUNCTIONS \
    FUNCTION(iron_of_numbers), FUNCTION(iron_state), FUNCTION(iron_solve), FUNCTION(iron_linkages), FUNCTION(iron_solve_in), \
    FUNCTION(iron_step), \
    FUNCTION(iron_remembered), FUNCTION(iron_recall), \
    FUNCTION(iron_amplitudes), FUNCTION(iron_continued), FUNCTION(cells_respond)
#define IRON_CONSTANTS \
    CONSTANT(OK), CONSTANT(NOT_FINITE), CONSTANT(IRON_BEYOND), CONSTANT(IRON_NOT_CONVERGED), CONSTANT(IRON_STEPS), \
    CONSTANT(IRON_LANES), CONSTANT(IRON_SIZES), CONSTANT(IRON_PASSED)

#endif
