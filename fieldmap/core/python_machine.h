/* python_machine.h: machines, for Python: see fieldmap.core.machine.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_MACHINE_H
#define FIELDMAP_PYTHON_MACHINE_H

#include "machine.h"
#include "python_body.h"
#include "python_iron.h"
#include "python_map.h"
#include "python_table.h"

static const char *const MACHINE = "fieldmap.core.machine";

/* Read a rigid body from attributes with the names of fieldmap_rigid_body. */
static void read_rigid_body(reader given, fieldmap_rigid_body *out)
{
    const fieldmap_magnetic_body *magnetic = (const fieldmap_magnetic_body *)held_of(&given, "magnetic", BODY);
    const number_array skin = points_of(&given, "skin");
    const double *drag = (const double *)&out->drag;
    int k;
    out->mass = real_of(&given, "mass");
    copy_of(&given, "inertia", 1, 3, out->inertia);
    copy_of(&given, "gravity", 1, 3, out->gravity);
    copy_of(&given, "force", 1, 3, out->force);
    copy_of(&given, "torque", 1, 3, out->torque);
    copy_of(&given, "drag", 2, 15, (double *)&out->drag);
    copy_of(&given, "plate", 1, 8, (double *)&out->plate);
    copy_of(&given, "seen_by_plate", 1, 6, (double *)&out->seen_by_plate);
    copy_of(&given, "walls", 1, 9, (double *)&out->walls);
    if (PyErr_Occurred()) return;
    out->skin = skin.at, out->n_skin = (int)skin.shape[0], out->magnetic = *magnetic;
    for (k = 0; k < 15; k++) out->lossy |= drag[k] != 0.0;
}

/* Read scale, iron, tolerance of its solves, on_path and table, by which the field follows the currents. */
static void read_superposition(reader *given, fieldmap_superposition *out)
{
    fieldmap_iron_state *iron = (fieldmap_iron_state *)held_or_none(given, "iron", STATE);
    const fieldmap_current_table *table = (const fieldmap_current_table *)held_or_none(given, "table", TABLE);
    const double tolerance = real_of(given, "tolerance");
    out->scale = real_of(given, "scale"), out->iron = iron, out->table = table;
    out->on_path = (int)whole_of(given, "on_path");
    /* Solves at currents outside the domain are allowed. */
    if (iron != NULL) iron->tolerance = tolerance, iron->checked = 0;
    require((iron == NULL || iron->map->n_fields == out->n_fields) && (table == NULL || table->fields + 6 == out->n_fields),
            PyExc_ValueError, "the iron has other fields than the map");
}

/* Allocate the memory of a machine after all else is read. */
static void give_memory(reader *from, fieldmap_machine *machine)
{
    const int points = fieldmap_body_points(&machine->body.magnetic), sets = fieldmap_sets(machine->field.map);
    const size_t rows = (size_t)points * (size_t)fieldmap_path_row(machine->field.map);
    int k;
    machine->weights = (double *)memory_of(from, ((size_t)sets + (size_t)machine->n_coils + rows) * sizeof(double));
    machine->field.places = (int64_t *)memory_of(from, (size_t)points * sizeof(int64_t));
    if (PyErr_Occurred()) return;
    machine->scratch = machine->weights + sets;
    for (k = 0; k < sets; k++) machine->weights[k] = machine->superposition.scale;
    machine->field.weights = machine->weights;
    machine->field.rows = machine->scratch + machine->n_coils;
    machine->field.points = points;
    fieldmap_path_forget(&machine->field);
}

/* Read the coupled coils of a machine last: None, or an object with coils (n, 15), inductance (n, n), constant (n,),
 * largest. */
static void read_electrical(reader *from, PyObject *given, fieldmap_machine *machine)
{
    const int n = machine->n_coils, points = machine->body.magnetic.n_dipoles;
    const fieldmap *map = machine->field.map;
    const size_t size = (sizeof(fieldmap_electrical) + 63) / 64 * 64;
    fieldmap_electrical *e;
    char *memory;
    reader part = attributes_of(from, given);
    if (given == NULL || given == Py_None) return;
    memory = (char *)memory_of(from, size + sizeof(double) * fieldmap_electrical_room(n, map, points));
    e = (fieldmap_electrical *)memory;
    require(machine->superposition.table == NULL, PyExc_ValueError, "a table of currents has no linkages");
    if (PyErr_Occurred()) return;
    e->n = n, e->fields = machine->superposition.n_fields;
    e->coils = (const fieldmap_coil *)numbers_of(&part, "coils", 2, FIELDMAP_COIL * n).at;
    e->linear.inductance = numbers_of(&part, "inductance", 2, n * n).at;
    e->linear.constant = numbers_of(&part, "constant", 1, n).at;
    e->linear.coils = n;
    e->largest = real_of(&part, "largest");
    if (PyErr_Occurred()) return;
    fieldmap_electrical_start(e, map, points, (double *)(void *)(memory + size));
    machine->electrical = e;
}

static void read_machine(reader *from, void *out)
{
    fieldmap_machine *machine = (fieldmap_machine *)out;
    reader given = part_of(from, "plant");
    const fieldmap *map = (const fieldmap *)held_of(&given, "map", MAP);
    const number_array windings = numbers_of(&given, "windings", 2, ANY);
    const npy_intp coils = windings.shape[0];
    read_rigid_body(part_of(&given, "body"), &machine->body);
    require(windings.size == 4 * coils, PyExc_TypeError, "windings must be (n, 4)");
    machine->windings = (const fieldmap_winding *)windings.at;
    machine->drives = (const fieldmap_drive *)numbers_of(&given, "drives", 2, 7 * coils).at;
    copy_of(&given, "seen_at", 1, 3, machine->seen_at);
    if (PyErr_Occurred()) return;
    require(!map->constant, PyExc_ValueError, "all sets of the map must have weights");
    require(coils <= fieldmap_sets(map), PyExc_ValueError, "the map has fewer fields than there are coils");
    machine->field.map = map;
    machine->n_coils = machine->superposition.n_coils = (int)coils;
    machine->superposition.n_fields = fieldmap_sets(map);
    read_superposition(&given, &machine->superposition);
    give_memory(&given, machine);
    read_electrical(&given, value_of(&given, "coupled"), machine);
}

/* machine(plant): of an object with map, body, seen_at, scale, iron, tolerance, on_path, table, windings (n, 4), drives
 * (n, 7) and coupled, None or as read_electrical takes it. */
static PyObject *machine(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 1);
    (void)self;
    return held(&from, MACHINE, sizeof(fieldmap_machine), read_machine);
}

static fieldmap_machine *machine_of(reader *from)
{
    return (fieldmap_machine *)held_of(from, "machine", MACHINE);
}

/* The numbers of a state to read or to fill. */
static fieldmap_state *state_of(reader *from, const char *name)
{
    return (fieldmap_state *)filled_of(from, name, FIELDMAP_STATE);
}

/* machine_follow(machine, currents): see fieldmap.core.machine. */
static PyObject *machine_follow(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 2);
    fieldmap_machine *machine = machine_of(&from);
    const double *currents = numbers_of(&from, "currents", 1, machine == NULL ? 0 : machine->n_coils).at;
    (void)self;
    return PyErr_Occurred() ? NULL : PyBool_FromLong(fieldmap_machine_follow(machine, currents));
}

/* machine_weights(machine): present weights of the fields. */
static PyObject *machine_weights(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 1);
    const fieldmap_machine *machine = machine_of(&from);
    PyObject *weights;
    double *out;
    (void)self;
    if (machine == NULL) return NULL;
    weights = new_array(1, machine->superposition.n_fields, 0, &out);
    if (weights != NULL) memcpy(out, machine->weights, (size_t)machine->superposition.n_fields * sizeof(double));
    return weights;
}

/* machine_solves(machine): the counters of fieldmap.core.machine.Solves. */
static PyObject *machine_solves(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 1);
    const fieldmap_machine *machine = machine_of(&from);
    const fieldmap_superposition *of = machine == NULL ? NULL : &machine->superposition;
    (void)self;
    if (of == NULL) return NULL;
    return Py_BuildValue("(LLLL)", (long long)of->solves, (long long)of->newton_steps, (long long)of->unsolved,
                         (long long)of->outside);
}

/* machine_load(machine, state, load): fill load (6,); (status of the map, contact flags). */
static PyObject *machine_load(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 3);
    const fieldmap_machine *machine = machine_of(&from);
    const fieldmap_state *state = state_of(&from, "state");
    double *load = filled_of(&from, "load", 6);
    int status, touched;
    (void)self;
    if (PyErr_Occurred()) return NULL;
    status = fieldmap_load(&machine->field, &machine->body, state, load, &touched);
    return Py_BuildValue("(ii)", status, touched);
}

/* machine_energy(machine, state): energy of magnets and soft iron in the field, J, or None where the field is unknown. */
static PyObject *machine_energy(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 2);
    const fieldmap_machine *machine = machine_of(&from);
    const fieldmap_state *state = state_of(&from, "state");
    double r[9], energy;
    (void)self;
    if (PyErr_Occurred()) return NULL;
    fieldmap_rotation(state->turn, r);
    if (fieldmap_body_energy(&machine->field, &machine->body.magnetic, state->position, r, &energy) != FIELDMAP_OK)
        Py_RETURN_NONE;
    return PyFloat_FromDouble(energy);
}

/* machine_rates(machine, state, out): fill the time derivative (13,); the status of the map. */
static PyObject *machine_rates(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 3);
    const fieldmap_machine *machine = machine_of(&from);
    const fieldmap_state *state = state_of(&from, "state");
    fieldmap_state *out = state_of(&from, "out");
    (void)self;
    return PyErr_Occurred() ? NULL : PyLong_FromLong(fieldmap_rates(&machine->field, &machine->body, state, out));
}

/* machine_losses(machine, state): force (3,), frame of the map, and torque (3,), frame of the body. */
static PyObject *machine_losses(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 2);
    const fieldmap_machine *machine = machine_of(&from);
    const fieldmap_state *state = state_of(&from, "state");
    double r[9], force[3], torque[3];
    (void)self;
    if (PyErr_Occurred()) return NULL;
    fieldmap_rotation(state->turn, r);
    fieldmap_losses(&machine->body, state->position, r, state->velocity, state->angular_velocity, force, torque);
    return Py_BuildValue("((ddd)(ddd))", force[0], force[1], force[2], torque[0], torque[1], torque[2]);
}

/* machine_move(machine, state, step, every, order, states): (rows filled, status of the map, contact flags). */
static PyObject *machine_move(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 6);
    fieldmap_machine *machine = machine_of(&from);
    fieldmap_state *state = state_of(&from, "state");
    const double step = real_of(&from, "step");
    const long every = whole_of(&from, "every"), order = whole_of(&from, "order");
    const number_array states = filled_numbers(&from, "states", 2, ANY);
    const long count = (long)states.shape[0];
    long filled;
    int status, touched;
    (void)self;
    require(count >= 1 && states.shape[1] == FIELDMAP_STATE, PyExc_TypeError, "states must be (n, 13)");
    if (PyErr_Occurred()) return NULL;
    Py_BEGIN_ALLOW_THREADS
    filled = fieldmap_move(machine, state, step, every, (int)order, count, (fieldmap_state *)states.at, &status, &touched);
    Py_END_ALLOW_THREADS
    return Py_BuildValue("(lii)", filled, status, touched);
}

/* machine_electrical(machine): state (k, n) of coupled coils, in the order of fieldmap_electrical, and numbers of tangents and
 * Newton steps; None without coupled coils. */
static PyObject *machine_electrical(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 1);
    const fieldmap_machine *machine = machine_of(&from);
    const fieldmap_electrical *e = machine == NULL ? NULL : machine->electrical;
    PyObject *array;
    double *out;
    (void)self;
    if (machine == NULL) return NULL;
    if (e == NULL) Py_RETURN_NONE;
    array = new_array(2, FIELDMAP_ELECTRICAL_STATE, e->n, &out);
    if (array == NULL) return NULL;
    memcpy(out, e->linkage, (size_t)(FIELDMAP_ELECTRICAL_STATE * e->n) * sizeof(double));
    return Py_BuildValue("(NLL)", array, (long long)e->tangents, (long long)e->steps);
}

/* machine_advance(machine, step, steps, commands, state, currents, load): one control period; the status of the map. */
static PyObject *machine_advance(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 7);
    fieldmap_machine *machine = machine_of(&from);
    const int coils = machine == NULL ? 0 : machine->n_coils;
    const double step = real_of(&from, "step");
    const long steps = whole_of(&from, "steps");
    const double *commands = numbers_of(&from, "commands", 1, coils).at;
    fieldmap_state *state = state_of(&from, "state");
    double *currents = filled_of(&from, "currents", coils), *load = filled_of(&from, "load", 6);
    int status;
    (void)self;
    if (PyErr_Occurred()) return NULL;
    Py_BEGIN_ALLOW_THREADS
    status = fieldmap_advance(machine, step, steps, commands, state, currents, load);
    Py_END_ALLOW_THREADS
    return PyLong_FromLong(status);
}

/* plate_force(plate (8,), place, moment, velocity, rate): force (3,) and turning (3,): see losses.h. */
static PyObject *plate_force(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 5);
    const fieldmap_plate *plate = (const fieldmap_plate *)numbers_of(&from, "plate", 1, 8).at;
    fieldmap_moving_dipole dipole;
    double force[3], turning[3];
    (void)self;
    copy_of(&from, "place", 1, 3, dipole.place);
    copy_of(&from, "moment", 1, 3, dipole.moment);
    copy_of(&from, "velocity", 1, 3, dipole.velocity);
    copy_of(&from, "rate", 1, 3, dipole.rate);
    if (PyErr_Occurred()) return NULL;
    fieldmap_plate_force(plate, &dipole, force, turning);
    return Py_BuildValue("((ddd)(ddd))", force[0], force[1], force[2], turning[0], turning[1], turning[2]);
}

/* rotation(turn (4,)): the matrix (3, 3) from the body to the map. */
static PyObject *rotation(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 1);
    const double *turn = numbers_of(&from, "turn", 1, 4).at;
    PyObject *matrix;
    double *out;
    (void)self;
    if (turn == NULL) return NULL;
    matrix = new_array(2, 3, 3, &out);
    if (matrix != NULL) fieldmap_rotation(turn, out);
    return matrix;
}

#define MACHINE_FUNCTIONS \
    FUNCTION(machine), FUNCTION(machine_follow), FUNCTION(machine_weights), FUNCTION(machine_solves), \
    FUNCTION(machine_load), FUNCTION(machine_energy), FUNCTION(machine_rates), FUNCTION(machine_losses), \
    FUNCTION(machine_move), FUNCTION(machine_electrical), FUNCTION(machine_advance), FUNCTION(plate_force), FUNCTION(rotation)

/* First index of a member in the numbers of a state. */
#define PLACE(name, member) {#name, (long)(offsetof(fieldmap_state, member) / sizeof(double))}

#define MACHINE_CONSTANTS \
    CONSTANT(ON_FLOOR), CONSTANT(ON_CEILING), CONSTANT(ON_WALL), CONSTANT(STATE), PLACE(POSITION, position), \
    PLACE(VELOCITY, velocity), PLACE(TURN, turn), PLACE(ANGULAR_VELOCITY, angular_velocity)

#endif
