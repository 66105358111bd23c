/* python_several_bodies.h: bodies that act on each other, for Python: see fieldmap.core.several_bodies.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_SEVERAL_BODIES_H
#define FIELDMAP_PYTHON_SEVERAL_BODIES_H

#include "python_machine.h"
#include "several_bodies.h"

static const char *const SEVERAL = "fieldmap.core.several_bodies";

/* Allocate the memory of bodies after all else is read. */
static void give_memory_to_several(reader *from, fieldmap_several *of)
{
    const fieldmap *map = of->machine->field.map;
    const size_t count = (size_t)of->count, points = (size_t)of->all.points, rows = points * (size_t)fieldmap_path_row(map);
    of->field.map = map, of->field.weights = of->machine->weights, of->field.points = (int)points;
    of->field.places = (int64_t *)memory_of(from, points * sizeof(int64_t));
    of->field.rows = (double *)memory_of(from, rows * sizeof(double));
    of->all.sites = (fieldmap_site *)memory_of(from, points * sizeof(fieldmap_site));
    of->room = (double *)memory_of(from, fieldmap_looked_room(map, (int)points) * sizeof(double));
    of->wrench = (double *)memory_of(from, 6 * count * sizeof(double));
    if (PyErr_Occurred()) return;
    fieldmap_path_forget(&of->field);
}

static void read_several(reader *from, void *out)
{
    fieldmap_several *of = (fieldmap_several *)out;
    PyObject *bodies;
    fieldmap_rigid_body *read;
    Py_ssize_t count, n;
    of->machine = machine_of(from);
    bodies = value_of(from, "bodies");
    count = bodies != NULL && PyTuple_Check(bodies) ? PyTuple_Size(bodies) : 0;
    require(count > 0 && count <= BODY_PARTS, PyExc_TypeError, "bodies must be a tuple of one or more");
    read = (fieldmap_rigid_body *)memory_of(from, (size_t)count * sizeof *read);
    of->placed = (fieldmap_placed *)memory_of(from, (size_t)count * sizeof *of->placed);
    for (n = 0; n < count && !PyErr_Occurred(); n++) {
        read_rigid_body(attributes_of(from, PyTuple_GetItem(bodies, n)), read + n);
        of->placed[n].body = &read[n].magnetic;
    }
    of->radii = numbers_of(from, "radii", 1, count).at;
    copy_of(from, "contact", 1, 9, (double *)&of->contact);
    if (PyErr_Occurred()) return;
    of->count = of->all.count = (int)count, of->bodies = read, of->all.placed = of->placed;
    of->all.points = fieldmap_points_of(of->count, of->placed);
    give_memory_to_several(from, of);
}

/* several_bodies(machine, bodies, radii (n,), contact (9,)): see fieldmap.core.several_bodies. */
static PyObject *several_bodies(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = kept_arguments(args, given, 4);
    (void)self;
    return held(&from, SEVERAL, sizeof(fieldmap_several), read_several);
}

static fieldmap_several *several_of(reader *from)
{
    return (fieldmap_several *)held_of(from, "several", SEVERAL);
}

/* The states (n, 13) of the bodies. */
static fieldmap_state *states_of(reader *from, const fieldmap_several *of)
{
    return (fieldmap_state *)filled_of(from, "states", of == NULL ? 0 : of->count * FIELDMAP_STATE);
}

/* several_follow(several, currents): as machine_follow. */
static PyObject *several_follow(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 2);
    fieldmap_several *of = several_of(&from);
    const double *currents = numbers_of(&from, "currents", 1, of == NULL ? 0 : of->machine->n_coils).at;
    (void)self;
    return PyErr_Occurred() ? NULL : PyBool_FromLong(fieldmap_several_follow(of, currents));
}

/* several_wrench(several, states, wrench): fill wrench (n, 6); (status, energy). */
static PyObject *several_wrench(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 3);
    fieldmap_several *of = several_of(&from);
    const fieldmap_state *states = states_of(&from, of);
    double *wrench = filled_of(&from, "wrench", of == NULL ? 0 : 6 * of->count), energy = 0.0;
    int status;
    (void)self;
    if (PyErr_Occurred()) return NULL;
    status = fieldmap_several_wrench(of, states, &energy);
    memcpy(wrench, of->wrench, 6 * (size_t)of->count * sizeof(double));
    return Py_BuildValue("(id)", status, energy);
}

/* several_fault(several): the number of the body at fault, and the point in the map (3,). */
static PyObject *several_fault(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 1);
    const fieldmap_several *of = several_of(&from);
    PyObject *place;
    double *out;
    (void)self;
    if (of == NULL) return NULL;
    place = new_array(1, 3, 0, &out);
    if (place == NULL) return NULL;
    memcpy(out, of->all.sites[of->fault].at, 3 * sizeof(double));
    return Py_BuildValue("(iN)", of->all.sites[of->fault].owner, place);
}

/* several_move(several, states, step, every, order, rows (m, n, 13)): (rows filled, status, contact flags). */
static PyObject *several_move(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 6);
    fieldmap_several *of = several_of(&from);
    fieldmap_state *states = states_of(&from, of);
    const double step = real_of(&from, "step");
    const long every = whole_of(&from, "every"), order = whole_of(&from, "order");
    const number_array rows = filled_numbers(&from, "rows", 3, ANY);
    double *loads = (double *)memory_of(&from, of == NULL ? 0 : 6 * (size_t)of->count * sizeof(double));
    long filled = 0;
    int status = FIELDMAP_OK, touched = 0;
    (void)self;
    require(of == NULL || (rows.shape[0] >= 1 && rows.size == rows.shape[0] * of->count * FIELDMAP_STATE), PyExc_TypeError,
            "rows must be (m, n, 13)");
    if (PyErr_Occurred()) return nothing(&from);
    Py_BEGIN_ALLOW_THREADS
    filled = fieldmap_several_move(of, states, loads, step, every, (int)order, (long)rows.shape[0], (fieldmap_state *)rows.at,
                                   &status, &touched);
    Py_END_ALLOW_THREADS
    return answer(&from, Py_BuildValue("(lii)", filled, status, touched));
}

#define SEVERAL_BODIES_FUNCTIONS \
    FUNCTION(several_bodies), FUNCTION(several_follow), FUNCTION(several_wrench), FUNCTION(several_fault), \
    FUNCTION(several_move)
#define SEVERAL_BODIES_CONSTANTS CONSTANT(ON_BODY), CONSTANT(UNSETTLED)

#endif
