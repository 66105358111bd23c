/* python_machine.h: machines and closed loops, for Python: see fieldmap.core.machine and fieldmap.core.closed_loop.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_MACHINE_H
#define FIELDMAP_PYTHON_MACHINE_H

#include "closed_loop.h"
#include "python_arrays.h"
#include "python_body.h"
#include "python_controller.h"
#include "python_iron.h"
#include "python_map.h"
#include "python_table.h"

static const char *const MACHINE = "fieldmap.core.machine";

/* A machine, what it was made of, and the memory that it works in. */
typedef struct held_machine {
    fieldmap_machine machine;
    PyObject *kept;
    double *numbers;
    int64_t *places;
} held_machine;

static void free_machine(held_machine *held)
{
    Py_XDECREF(held->kept);
    PyMem_Free(held->numbers);
    PyMem_Free(held->places);
    PyMem_Free(held);
}

static void release_machine(PyObject *capsule)
{
    held_machine *held = (held_machine *)PyCapsule_GetPointer(capsule, MACHINE);
    if (held != NULL) free_machine(held);
}

static fieldmap_machine *machine_in(PyObject *capsule)
{
    held_machine *held = (held_machine *)PyCapsule_GetPointer(capsule, MACHINE);
    return held == NULL ? NULL : &held->machine;
}

/* A rigid body from the attributes that have the names of fieldmap_rigid_body. */
static int read_rigid_body(PyObject *given, fieldmap_rigid_body *out, PyObject *kept)
{
    const held_body *magnetic;
    const npy_intp skin = rows_of_attribute(given, "skin");
    int sound = skin >= 0 && real_attribute(given, "mass", &out->mass) && numbers_attribute(given, "inertia", 1, 3, out->inertia)
        && numbers_attribute(given, "gravity", 1, 3, out->gravity) && numbers_attribute(given, "force", 1, 3, out->force)
        && numbers_attribute(given, "torque", 1, 3, out->torque)
        && numbers_attribute(given, "drag", 2, 15, (double *)&out->drag)
        && numbers_attribute(given, "plate", 1, 8, (double *)&out->plate)
        && numbers_attribute(given, "seen_by_plate", 1, 6, (double *)&out->seen_by_plate)
        && numbers_attribute(given, "walls", 1, 9, (double *)&out->walls)
        && (out->skin = kept_attribute(given, "skin", 2, 3 * skin, kept)) != NULL;
    const double *drag = (const double *)&out->drag;
    int k;
    if (!sound) return 0;
    magnetic = (const held_body *)capsule_attribute(given, "magnetic", BODY, kept);
    if (magnetic == NULL) return 0;
    out->magnetic = magnetic->body;
    out->n_skin = (int)skin;
    for (k = 0; k < 15; k++) out->lossy |= drag[k] != 0.0;
    return 1;
}

/* How the field follows the currents: scale, iron, tolerance of its solves, and table. */
static int read_superposition(PyObject *given, fieldmap_superposition *out, PyObject *kept)
{
    held_state *iron;
    held_table *table;
    double tolerance;
    if (!real_attribute(given, "scale", &out->scale) || !real_attribute(given, "tolerance", &tolerance)) return 0;
    iron = (held_state *)capsule_attribute(given, "iron", STATE, kept);
    table = (held_table *)capsule_attribute(given, "table", TABLE, kept);
    if (PyErr_Occurred()) return 0;
    if (iron != NULL) {
        /* Currents beyond the domain are solved, too. */
        iron->state.tolerance = tolerance, iron->state.checked = 0;
        out->iron = &iron->state;
    }
    out->table = table == NULL ? NULL : &table->table;
    if ((out->iron == NULL || out->iron->map->n_fields == out->n_fields)
        && (out->table == NULL || out->table->fields + 6 == out->n_fields))
        return 1;
    PyErr_SetString(PyExc_ValueError, "the iron has other fields than the map");
    return 0;
}

/* The memory of a machine that is read but for that. */
static int give_memory(held_machine *held)
{
    fieldmap_machine *machine = &held->machine;
    const int points = fieldmap_body_points(&machine->body.magnetic), sets = fieldmap_sets(machine->field.map);
    const size_t rows = (size_t)points * (size_t)fieldmap_path_row(machine->field.map);
    int k;
    held->numbers = (double *)PyMem_Calloc((size_t)sets + (size_t)machine->n_coils + rows + 1, sizeof(double));
    held->places = (int64_t *)PyMem_Calloc((size_t)points + 1, sizeof(int64_t));
    if (held->numbers == NULL || held->places == NULL) {
        PyErr_NoMemory();
        return 0;
    }
    machine->weights = held->numbers, machine->scratch = machine->weights + sets;
    for (k = 0; k < sets; k++) machine->weights[k] = machine->superposition.scale;
    machine->field.weights = machine->weights;
    machine->field.rows = machine->scratch + machine->n_coils;
    machine->field.points = points, machine->field.places = held->places;
    fieldmap_path_forget(&machine->field);
    return 1;
}

static int read_machine(PyObject *given, held_machine *held)
{
    fieldmap_machine *machine = &held->machine;
    const held_map *map = (const held_map *)capsule_attribute(given, "map", MAP, held->kept);
    const npy_intp coils = rows_of_attribute(given, "windings");
    PyObject *body;
    int sound;
    if (map == NULL || coils < 0) return 0;
    if (map->map.constant) {
        PyErr_SetString(PyExc_ValueError, "all sets of the map must have weights");
        return 0;
    }
    machine->field.map = &map->map;
    machine->n_coils = machine->superposition.n_coils = (int)coils;
    machine->superposition.n_fields = fieldmap_sets(&map->map);
    if (coils > machine->superposition.n_fields) {
        PyErr_SetString(PyExc_ValueError, "the map has fewer fields than there are coils");
        return 0;
    }
    body = PyObject_GetAttrString(given, "body");
    sound = body != NULL && read_rigid_body(body, &machine->body, held->kept);
    Py_XDECREF(body);
    machine->windings = sound ? (const fieldmap_winding *)kept_attribute(given, "windings", 2, 4 * coils, held->kept) : NULL;
    machine->drives = sound ? (const fieldmap_drive *)kept_attribute(given, "drives", 2, 7 * coils, held->kept) : NULL;
    return machine->windings != NULL && machine->drives != NULL && numbers_attribute(given, "seen_at", 1, 3, machine->seen_at)
        && read_superposition(given, &machine->superposition, held->kept) && give_memory(held);
}

/* machine(plant): of an object with map, body, seen_at, scale, iron, tolerance, table, windings (n, 4) and drives (n, 7). */
static PyObject *machine(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    held_machine *held;
    PyObject *capsule = NULL;
    (void)self;
    if (!has_arguments(given, 1)) return NULL;
    held = (held_machine *)PyMem_Calloc(1, sizeof *held);
    if (held == NULL) return PyErr_NoMemory();
    held->kept = PyList_New(0);
    if (held->kept != NULL && read_machine(args[0], held)) capsule = PyCapsule_New(held, MACHINE, release_machine);
    if (capsule == NULL) {
        if (!PyErr_Occurred()) PyErr_SetString(PyExc_TypeError, "a part of the machine is missing");
        free_machine(held);
    }
    return capsule;
}

/* The numbers of a state to read or to fill; raises TypeError. */
static fieldmap_state *state_of(PyObject *given)
{
    return (fieldmap_state *)numbers_to_fill(given, FIELDMAP_STATE, "state");
}

/* machine_follow(machine, currents): the field becomes that of these currents; whether they lie where that is known. */
static PyObject *machine_follow(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    fieldmap_machine *machine;
    const double *currents;
    (void)self;
    if (!has_arguments(given, 2) || (machine = machine_in(args[0])) == NULL) return NULL;
    currents = numbers_of(args[1], 1, machine->n_coils);
    if (currents != NULL) return PyBool_FromLong(fieldmap_machine_follow(machine, currents));
    PyErr_Format(PyExc_TypeError, "currents must be a float64 vector of %d", machine->n_coils);
    return NULL;
}

/* machine_weights(machine): of the fields, as they are. */
static PyObject *machine_weights(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const fieldmap_machine *machine;
    PyObject *weights;
    npy_intp sets;
    (void)self;
    if (!has_arguments(given, 1) || (machine = machine_in(args[0])) == NULL) return NULL;
    sets = machine->superposition.n_fields;
    weights = PyArray_SimpleNew(1, &sets, NPY_DOUBLE);
    if (weights != NULL)
        memcpy(PyArray_DATA((PyArrayObject *)weights), machine->weights, (size_t)sets * sizeof(double));
    return weights;
}

/* machine_solves(machine): solves of the iron's model, their Newton steps, those not converged, those beyond the domain. */
static PyObject *machine_solves(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const fieldmap_superposition *of;
    fieldmap_machine *machine;
    (void)self;
    if (!has_arguments(given, 1) || (machine = machine_in(args[0])) == NULL) return NULL;
    of = &machine->superposition;
    return Py_BuildValue("(LLLL)", (long long)of->solves, (long long)of->newton_steps, (long long)of->unsolved,
                         (long long)of->outside);
}

/* machine_load(machine, state, load): fill load (6,); (status of the map, what is touched). */
static PyObject *machine_load(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const fieldmap_machine *machine;
    const fieldmap_state *state;
    double *load;
    int status, touched;
    (void)self;
    if (!has_arguments(given, 3) || (machine = machine_in(args[0])) == NULL || (state = state_of(args[1])) == NULL) return NULL;
    load = numbers_to_fill(args[2], 6, "load");
    if (load == NULL) return NULL;
    status = fieldmap_load(&machine->field, &machine->body, state, load, &touched);
    return Py_BuildValue("(ii)", status, touched);
}

/* machine_energy(machine, state): of magnets and soft iron in the field, J, or None where that is not known. */
static PyObject *machine_energy(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const fieldmap_machine *machine;
    const fieldmap_state *state;
    double r[9], energy;
    (void)self;
    if (!has_arguments(given, 2) || (machine = machine_in(args[0])) == NULL || (state = state_of(args[1])) == NULL) return NULL;
    fieldmap_rotation(state->turn, r);
    if (fieldmap_body_energy(&machine->field, &machine->body.magnetic, state->position, r, &energy) != FIELDMAP_OK)
        Py_RETURN_NONE;
    return PyFloat_FromDouble(energy);
}

/* machine_rates(machine, state, out): fill the time derivative (13,); the status of the map. */
static PyObject *machine_rates(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const fieldmap_machine *machine;
    const fieldmap_state *state;
    fieldmap_state *out;
    (void)self;
    if (!has_arguments(given, 3) || (machine = machine_in(args[0])) == NULL || (state = state_of(args[1])) == NULL) return NULL;
    out = state_of(args[2]);
    if (out == NULL) return NULL;
    return PyLong_FromLong(fieldmap_rates(&machine->field, &machine->body, state, out));
}

/* machine_losses(machine, state): force (3,), frame of the map, and torque (3,), frame of the body. */
static PyObject *machine_losses(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const fieldmap_machine *machine;
    const fieldmap_state *state;
    double r[9], force[3], torque[3];
    (void)self;
    if (!has_arguments(given, 2) || (machine = machine_in(args[0])) == NULL || (state = state_of(args[1])) == NULL) return NULL;
    fieldmap_rotation(state->turn, r);
    fieldmap_losses(&machine->body, state->position, r, state->velocity, state->angular_velocity, force, torque);
    return Py_BuildValue("((ddd)(ddd))", force[0], force[1], force[2], torque[0], torque[1], torque[2]);
}

/* machine_move(machine, state, step, every, order, states): (rows filled, status of the map, what was touched). */
static PyObject *machine_move(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    PyArrayObject *states;
    fieldmap_machine *machine;
    fieldmap_state *state;
    double *rows, step;
    long every, order, filled;
    npy_intp count;
    int status, touched;
    (void)self;
    if (!has_arguments(given, 6) || (machine = machine_in(args[0])) == NULL || (state = state_of(args[1])) == NULL) return NULL;
    step = PyFloat_AsDouble(args[2]), every = PyLong_AsLong(args[3]), order = PyLong_AsLong(args[4]);
    if (PyErr_Occurred()) return NULL;
    states = (PyArrayObject *)args[5];
    count = PyArray_Check(args[5]) && PyArray_NDIM(states) == 2 ? PyArray_DIM(states, 0) : 0;
    rows = numbers_to_fill(args[5], FIELDMAP_STATE * count, "states");
    if (rows == NULL || count < 1) return NULL;
    Py_BEGIN_ALLOW_THREADS
    filled = fieldmap_move(machine, state, step, every, (int)order, (long)count, (fieldmap_state *)rows, &status, &touched);
    Py_END_ALLOW_THREADS
    return Py_BuildValue("(lii)", filled, status, touched);
}

/* machine_advance(machine, step, steps, commands, state, currents, load): one control period; the status of the map. */
static PyObject *machine_advance(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    fieldmap_machine *machine;
    fieldmap_state *state;
    const double *commands;
    double *currents, *load, step;
    long steps;
    int status;
    (void)self;
    if (!has_arguments(given, 7) || (machine = machine_in(args[0])) == NULL || (state = state_of(args[4])) == NULL) return NULL;
    step = PyFloat_AsDouble(args[1]), steps = PyLong_AsLong(args[2]);
    if (PyErr_Occurred()) return NULL;
    commands = numbers_of(args[3], 1, machine->n_coils);
    if (commands == NULL) {
        PyErr_Format(PyExc_TypeError, "commands must be a float64 vector of %d", machine->n_coils);
        return NULL;
    }
    currents = numbers_to_fill(args[5], machine->n_coils, "currents");
    load = currents == NULL ? NULL : numbers_to_fill(args[6], 6, "load");
    if (load == NULL) return NULL;
    Py_BEGIN_ALLOW_THREADS
    status = fieldmap_advance(machine, step, steps, commands, state, currents, load);
    Py_END_ALLOW_THREADS
    return PyLong_FromLong(status);
}

static int read_allocation(PyObject *given, fieldmap_allocation *out, int coils, PyObject *kept)
{
    PyArrayObject *matrix = array_attribute(given, "matrix", 2);
    long division;
    int sound = matrix != NULL && whole_attribute(given, "division", &division) && real_attribute(given, "exponent", &out->exponent);
    if (sound) {
        out->division = division != 0, out->n_coils = coils;
        out->n_outputs = division ? 3 : (int)PyArray_DIM(matrix, 1);
        sound = division ? coils == 6 : PyArray_DIM(matrix, 0) == coils;
        if (!sound) PyErr_SetString(PyExc_ValueError, "the allocation has other coils than the machine");
    }
    Py_XDECREF((PyObject *)matrix);
    return sound && (out->matrix = kept_attribute(given, "matrix", 2, -1, kept)) != NULL
        && (out->constant = kept_attribute(given, "constant", 1, coils, kept)) != NULL;
}

/* An inverse map in the machine of its own, but for its allocation. */
static int read_inverse(PyObject *given, fieldmap_inverse_map *out, PyObject *kept)
{
    held_machine *held = (held_machine *)capsule_attribute(given, "machine", MACHINE, kept);
    double limits[6];
    long rounds;
    int k;
    if (held == NULL || !whole_attribute(given, "rounds", &rounds) || !numbers_attribute(given, "limits", 2, 6, limits)) return 0;
    out->machine = &held->machine, out->rounds = (int)rounds;
    for (k = 0; k < 3; k++) out->lower[k] = limits[k], out->upper[k] = limits[3 + k];
    out->signals = filled_attribute(given, "signals", 1, 3, kept);
    out->believed = (fieldmap_state *)filled_attribute(given, "believed", 1, FIELDMAP_STATE, kept);
    return out->signals != NULL && out->believed != NULL;
}

/* inverse_along(inverse, allocation, positions, forces, found, left): the signals (p, 3) at which the magnets of a body at
 * positions (p, 3) feel forces (p, 3), and what is left of these (p,); each search begins where the last ended. */
static PyObject *inverse_along(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    fieldmap_inverse_map inverse;
    fieldmap_allocation allocation;
    const double *positions, *forces;
    double *found, *left;
    PyObject *kept;
    npy_intp count, also, p;
    int k, sound;
    (void)self;
    if (!has_arguments(given, 6)) return NULL;
    positions = points_of(args[2], &count);
    forces = points_of(args[3], &also);
    if (positions == NULL || forces == NULL || count != also) {
        PyErr_SetString(PyExc_TypeError, "positions and forces must be float64 arrays (p, 3) in C order");
        return NULL;
    }
    found = numbers_to_fill(args[4], 3 * count, "found");
    left = found == NULL ? NULL : numbers_to_fill(args[5], count, "left");
    kept = left == NULL ? NULL : PyList_New(0);
    if (kept == NULL) return NULL;
    sound = read_inverse(args[0], &inverse, kept) && read_allocation(args[1], &allocation, inverse.machine->n_coils, kept)
        && allocation.n_outputs == 3;
    if (sound) {
        inverse.allocation = &allocation;
        Py_BEGIN_ALLOW_THREADS
        for (p = 0; p < count; p++) {
            for (k = 0; k < 3; k++) inverse.believed->position[k] = positions[3 * p + k];
            left[p] = fieldmap_find_signals(&inverse, forces + 3 * p);
            for (k = 0; k < 3; k++) found[3 * p + k] = inverse.signals[k];
        }
        Py_END_ALLOW_THREADS
    }
    Py_DECREF(kept);
    if (sound) Py_RETURN_NONE;
    if (!PyErr_Occurred()) PyErr_SetString(PyExc_ValueError, "the allocation must take three signals");
    return NULL;
}

/* plate_force(plate (8,), place, moment, velocity, rate): force (3,) and what turns (3,): see losses.h. */
static PyObject *plate_force(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    fieldmap_moving_dipole dipole;
    double *parts[4] = {dipole.place, dipole.moment, dipole.velocity, dipole.rate}, force[3], turning[3];
    const fieldmap_plate *plate;
    int k;
    (void)self;
    if (!has_arguments(given, 5)) return NULL;
    plate = (const fieldmap_plate *)numbers_of(args[0], 1, 8);
    for (k = 0; k < 4 && plate != NULL; k++) {
        const double *numbers = numbers_of(args[1 + k], 1, 3);
        if (numbers == NULL) plate = NULL;
        else memcpy(parts[k], numbers, 3 * sizeof(double));
    }
    if (plate == NULL) {
        PyErr_SetString(PyExc_TypeError, "plate (8,) and four float64 vectors (3,) are needed");
        return NULL;
    }
    fieldmap_plate_force(plate, &dipole, force, turning);
    return Py_BuildValue("((ddd)(ddd))", force[0], force[1], force[2], turning[0], turning[1], turning[2]);
}

/* rotation(turn (4,)): the matrix (3, 3) from the body to the map. */
static PyObject *rotation(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    static const npy_intp shape[2] = {3, 3};
    const double *turn;
    PyObject *matrix;
    (void)self;
    if (!has_arguments(given, 1)) return NULL;
    turn = numbers_of(args[0], 1, 4);
    if (turn == NULL) {
        PyErr_SetString(PyExc_TypeError, "turn must be a float64 vector (4,)");
        return NULL;
    }
    matrix = PyArray_SimpleNew(2, shape, NPY_DOUBLE);
    if (matrix != NULL) fieldmap_rotation(turn, (double *)PyArray_DATA((PyArrayObject *)matrix));
    return matrix;
}

/* A part of an object by its name, which `kept` keeps alive. */
static PyObject *part_of(PyObject *of, const char *name, PyObject *kept)
{
    PyObject *part = PyObject_GetAttrString(of, name);
    if (part == NULL) return NULL;
    if (PyList_Append(kept, part) != 0) {
        Py_DECREF(part);
        return NULL;
    }
    Py_DECREF(part); /* The list has its own reference. */
    return part;
}

static int read_timing(PyObject *given, fieldmap_loop *out)
{
    long per_period, delay, every;
    if (!real_attribute(given, "step", &out->step) || !whole_attribute(given, "per_period", &per_period)
        || !whole_attribute(given, "delay", &delay) || !whole_attribute(given, "every", &every))
        return 0;
    out->per_period = per_period, out->delay = delay, out->every = every < 1 ? 1 : every;
    return 1;
}

static int read_sensing(PyObject *given, fieldmap_sensing *out)
{
    double scan[5];
    int k;
    if (!numbers_attribute(given, "into", 2, 9, out->into) || !numbers_attribute(given, "shift", 1, 3, out->shift)
        || !numbers_attribute(given, "back", 2, 9, out->back) || !numbers_attribute(given, "scan", 1, 5, scan)
        || !numbers_attribute(given, "chains", 2, 30, (double *)out->chains))
        return 0;
    out->scan_time = scan[0], out->latency = (int)scan[1];
    for (k = 0; k < 3; k++) out->averages[k] = scan[2 + k] < 1.0 ? 1 : (int)scan[2 + k];
    return 1;
}

/* The control law: address of a function, 0 for none, -1 for outputs that are given; controller, allocation, inverse. */
static int read_law(PyObject *given, fieldmap_loop *out, fieldmap_inverse_map *inverse, PyObject *kept)
{
    const held_controller *controller = (const held_controller *)capsule_attribute(given, "controller", CONTROLLER, kept);
    PyObject *allocation, *search, *address = part_of(given, "address", kept);
    long long number = address == NULL ? 0 : PyLong_AsLongLong(address);
    if (controller == NULL || PyErr_Occurred()) return 0;
    out->controller = &controller->controller;
    out->given = number == -1;
    out->function = number > 0 ? (fieldmap_control_function *)(uintptr_t)number : NULL;
    allocation = part_of(given, "allocation", kept);
    search = part_of(given, "inverse", kept);
    if (allocation == NULL || search == NULL) return 0;
    if (!read_allocation(allocation, &out->allocation, out->machine->n_coils, kept)) return 0;
    if (search != Py_None) {
        if (!read_inverse(search, inverse, kept)) return 0;
        inverse->allocation = &out->allocation;
        out->inverse = inverse;
    }
    if (out->controller->outputs == (search == Py_None ? out->allocation.n_outputs : 3)) return 1;
    PyErr_SetString(PyExc_ValueError, "the controller has other outputs than the allocation takes");
    return 0;
}

static int read_signals(PyObject *given, fieldmap_loop *out, PyObject *kept)
{
    const npy_intp coils = out->machine->n_coils, outputs = out->controller->outputs;
    out->samples = rows_of_attribute(given, "references");
    out->disturbed = rows_of_attribute(given, "loads");
    out->n_scans = rows_of_attribute(given, "scans");
    if (out->samples < 0 || out->disturbed < 1 || out->n_scans < 0 || (out->disturbed > 1 && out->disturbed < out->samples)
        || (out->sensing.scan_time > 0.0 && out->n_scans < 1)) {
        if (!PyErr_Occurred()) PyErr_SetString(PyExc_ValueError, "there are fewer loads or scans than samples");
        return 0;
    }
    return (out->references = kept_attribute(given, "references", 2, 3 * out->samples, kept)) != NULL
        && (out->feedforward = kept_attribute(given, "feedforward", 2, outputs * out->samples, kept)) != NULL
        && (out->disturbances = kept_attribute(given, "loads", 2, 6 * out->disturbed, kept)) != NULL
        && (out->noise = kept_attribute(given, "noise", 2, 3 * out->samples, kept)) != NULL
        && (out->voltage_noise = kept_attribute(given, "voltage_noise", 2, 3 * out->samples, kept)) != NULL
        && (out->current_noise = kept_attribute(given, "current_noise", 2, coils * out->samples, kept)) != NULL
        && (out->scans = filled_attribute(given, "scans", 2, 3 * out->n_scans, kept)) != NULL;
}

/* What moves, and the room of a run. */
static int read_room(PyObject *given, fieldmap_loop *out, PyObject *kept)
{
    const npy_intp coils = out->machine->n_coils, outputs = out->controller->outputs;
    PyArrayObject *memory = array_attribute(given, "memory", 1), *progress;
    npy_intp size, wide = FIELDMAP_STATE + 2 * coils + 3 + outputs;
    if (memory == NULL) return 0;
    size = PyArray_SIZE(memory);
    Py_DECREF((PyObject *)memory);
    out->memory_size = (int)size;
    out->max_rows = rows_of_attribute(given, "rows");
    if (out->function == NULL && !out->given && size != out->controller->states) {
        PyErr_SetString(PyExc_ValueError, "the memory is not that of the controller");
        return 0;
    }
    progress = (PyArrayObject *)part_of(given, "progress", kept);
    if (progress == NULL || !PyArray_Check((PyObject *)progress) || PyArray_TYPE(progress) != NPY_INT64
        || !PyArray_ISCARRAY(progress) || (size_t)PyArray_SIZE(progress) * sizeof(int64_t) != sizeof(fieldmap_progress)) {
        if (!PyErr_Occurred()) PyErr_SetString(PyExc_TypeError, "progress must be an int64 vector as fieldmap_progress has it");
        return 0;
    }
    out->progress = (fieldmap_progress *)PyArray_DATA(progress);
    return out->max_rows >= 0 && out->progress->rows >= 0 && out->progress->samples >= 0
        && (out->state = (fieldmap_state *)filled_attribute(given, "state", 1, FIELDMAP_STATE, kept)) != NULL
        && (out->currents = filled_attribute(given, "currents", 1, coils, kept)) != NULL
        && (out->memory = filled_attribute(given, "memory", 1, size, kept)) != NULL
        && (out->load = filled_attribute(given, "load", 1, 6, kept)) != NULL
        && (out->commands = filled_attribute(given, "commands", 1, coils, kept)) != NULL
        && (out->waiting = filled_attribute(given, "waiting", 1, coils, kept)) != NULL
        && (out->late = filled_attribute(given, "late", 1, coils, kept)) != NULL
        && (out->signals = filled_attribute(given, "seen", 1, FIELDMAP_SIGNALS, kept)) != NULL
        && (out->outputs = filled_attribute(given, "outputs", 1, outputs, kept)) != NULL
        && (out->scratch = filled_attribute(given, "scratch", 1, size + 2 * outputs, kept)) != NULL
        && (out->voltages = filled_attribute(given, "voltages", 1, coils, kept)) != NULL
        && (out->rows = filled_attribute(given, "rows", 2, wide * out->max_rows, kept)) != NULL;
}

static int read_loop(PyObject *given, fieldmap_loop *out, fieldmap_inverse_map *inverse, PyObject *kept)
{
    held_machine *held = (held_machine *)capsule_attribute(given, "machine", MACHINE, kept);
    PyObject *timing, *sensing, *law, *ending, *signals;
    long contacts, longest;
    memset(out, 0, sizeof *out);
    if (held == NULL) return 0;
    out->machine = &held->machine;
    timing = part_of(given, "timing", kept), sensing = part_of(given, "sensing", kept), law = part_of(given, "law", kept);
    ending = part_of(given, "ending", kept), signals = part_of(given, "signals", kept);
    if (timing == NULL || sensing == NULL || law == NULL || ending == NULL || signals == NULL) return 0;
    if (!whole_attribute(ending, "contacts", &contacts) || !whole_attribute(ending, "longest_saturation", &longest)) return 0;
    out->contacts = contacts, out->longest_saturation = longest;
    return read_timing(timing, out) && read_sensing(sensing, &out->sensing) && read_law(law, out, inverse, kept)
        && read_signals(signals, out, kept) && read_room(given, out, kept);
}

/* Begin a run, or go on with it, by one of the two functions of closed_loop.h: an event. */
static PyObject *with_loop(PyObject *given, int (*function)(fieldmap_loop *))
{
    fieldmap_inverse_map inverse;
    fieldmap_loop loop;
    PyObject *kept = PyList_New(0);
    int event = 0, sound;
    if (kept == NULL) return NULL;
    sound = read_loop(given, &loop, &inverse, kept);
    if (sound) {
        Py_BEGIN_ALLOW_THREADS
        event = function(&loop);
        Py_END_ALLOW_THREADS
    } else if (!PyErr_Occurred()) {
        PyErr_SetString(PyExc_TypeError, "a part of the loop is missing");
    }
    Py_DECREF(kept);
    return sound ? PyLong_FromLong(event) : NULL;
}

/* loop_begin(loop), loop_run(loop): see fieldmap.core.closed_loop. */
static PyObject *loop_begin(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    (void)self;
    return has_arguments(given, 1) ? with_loop(args[0], fieldmap_loop_begin) : NULL;
}

static PyObject *loop_run(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    (void)self;
    return has_arguments(given, 1) ? with_loop(args[0], fieldmap_loop_run) : NULL;
}

#define MACHINE_FUNCTIONS \
    FUNCTION(machine), FUNCTION(machine_follow), FUNCTION(machine_weights), FUNCTION(machine_solves), \
    FUNCTION(machine_load), FUNCTION(machine_energy), FUNCTION(machine_rates), FUNCTION(machine_losses), FUNCTION(machine_move), FUNCTION(machine_advance), \
    FUNCTION(inverse_along), FUNCTION(plate_force), FUNCTION(rotation), FUNCTION(loop_begin), FUNCTION(loop_run)

/* Where a member begins in the numbers of a state. */
#define PLACE(name, member) {#name, (long)(offsetof(fieldmap_state, member) / sizeof(double))}

#define MACHINE_CONSTANTS \
    CONSTANT(GOES_ON), CONSTANT(FELL_OUT), CONSTANT(LEFT_ABOVE), CONSTANT(LEFT_SIDEWAYS), CONSTANT(NOT_A_NUMBER), \
    CONSTANT(HIT_FLOOR), CONSTANT(HIT_POLE), CONSTANT(HIT_TUBE), CONSTANT(SATURATED), CONSTANT(BEYOND_CURRENTS), \
    CONSTANT(CONTROLLER_FAILED), CONSTANT(OUTPUTS_NOT_FINITE), CONSTANT(PAUSED), CONSTANT(ON_FLOOR), CONSTANT(ON_CEILING), \
    CONSTANT(ON_WALL), CONSTANT(BEYOND), CONSTANT(STATE), PLACE(POSITION, position), PLACE(VELOCITY, velocity), \
    PLACE(TURN, turn), PLACE(ANGULAR_VELOCITY, angular_velocity)

#endif
