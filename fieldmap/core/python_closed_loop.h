/* python_closed_loop.h: closed loops and inverse maps, for Python: see fieldmap.core.closed_loop.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_CLOSED_LOOP_H
#define FIELDMAP_PYTHON_CLOSED_LOOP_H

#include "closed_loop.h"
#include "python_controller.h"
#include "python_field_sensors.h"

static void read_allocation(reader given, fieldmap_allocation *out, int coils)
{
    const number_array matrix = numbers_of(&given, "matrix", 2, ANY);
    out->division = whole_of(&given, "division") != 0;
    out->exponent = real_of(&given, "exponent");
    out->matrix = matrix.at, out->constant = numbers_of(&given, "constant", 1, coils).at;
    out->n_coils = coils, out->n_outputs = out->division ? 3 : (int)matrix.shape[1];
    require(out->division ? coils == 6 : matrix.shape[0] == coils, PyExc_ValueError,
            "the allocation has other coils than the machine");
}

/* Read an inverse map, except its allocation. */
static void read_inverse(reader given, fieldmap_inverse_map *out)
{
    double limits[6] = {0.0};
    int k;
    out->machine = machine_of(&given), out->rounds = (int)whole_of(&given, "rounds");
    copy_of(&given, "limits", 2, 6, limits);
    for (k = 0; k < 3; k++) out->lower[k] = limits[k], out->upper[k] = limits[3 + k];
    out->signals = filled_of(&given, "signals", 3);
    out->believed = state_of(&given, "believed");
}

/* inverse_along(inverse, allocation, positions, forces, found, left): see fieldmap.core.machine. */
static PyObject *inverse_along(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 6);
    fieldmap_inverse_map inverse;
    fieldmap_allocation allocation;
    number_array positions, forces;
    double *found, *left;
    npy_intp p;
    int k;
    (void)self;
    read_inverse(part_of(&from, "inverse"), &inverse);
    read_allocation(part_of(&from, "allocation"), &allocation, inverse.machine == NULL ? 0 : inverse.machine->n_coils);
    positions = points_of(&from, "positions"), forces = points_of(&from, "forces");
    found = filled_of(&from, "found", positions.size);
    left = filled_of(&from, "left", positions.shape[0]);
    require(forces.size == positions.size, PyExc_TypeError, "positions and forces must be (p, 3)");
    require(allocation.n_outputs == 3, PyExc_ValueError, "the allocation must take three signals");
    if (!PyErr_Occurred()) {
        inverse.allocation = &allocation;
        Py_BEGIN_ALLOW_THREADS
        for (p = 0; p < positions.shape[0]; p++) {
            for (k = 0; k < 3; k++) inverse.believed->position[k] = positions.at[3 * p + k];
            left[p] = fieldmap_find_signals(&inverse, forces.at + 3 * p);
            for (k = 0; k < 3; k++) found[3 * p + k] = inverse.signals[k];
        }
        Py_END_ALLOW_THREADS
    }
    return nothing(&from);
}

static void read_timing(reader given, fieldmap_loop *out)
{
    out->step = real_of(&given, "step"), out->per_period = whole_of(&given, "per_period");
    out->delay = whole_of(&given, "delay"), out->every = whole_of(&given, "every");
    if (out->every < 1) out->every = 1;
}

/* Field sensors, or None. curve: memory for the calibration curve. */
static void read_field_sensing(reader *from, fieldmap_loop *out, fieldmap_calibration_curve *curve)
{
    fieldmap_field_sensing *sensing = &out->field_sensing;
    PyObject *value = value_of(from, "field"), *given_curve;
    reader given = attributes_of(from, value);
    int width;
    if (value == NULL || value == Py_None || out->machine == NULL) return;
    read_field_sensors(part_of(&given, "sensors"), fieldmap_sets(out->machine->field.map), &sensing->sensors);
    width = sensing->sensors.count + out->machine->n_coils;
    sensing->chains = (const fieldmap_chain *)numbers_of(&given, "chains", 2, CHAIN_NUMBERS * sensing->sensors.count).at;
    sensing->latency = (int)whole_of(&given, "latency"), sensing->sensor = (int)whole_of(&given, "sensor");
    copy_of(&given, "beside", 1, 2, sensing->beside);
    require(sensing->latency >= 0 && sensing->sensor >= 0 && sensing->sensor < sensing->sensors.count, PyExc_ValueError,
            "latency must not be negative, sensor the number of one of the sensors");
    if (PyErr_Occurred()) return;
    sensing->history = filled_of(&given, "history", (npy_intp)(sensing->latency + 1) * width);
    given_curve = value_of(&given, "curve");
    if (given_curve == NULL || given_curve == Py_None) return;
    read_calibration_curve(attributes_of(&given, given_curve), curve);
    require(curve->n_coils == out->machine->n_coils, PyExc_ValueError, "the curve has other coils than the machine");
    sensing->curve = curve;
}

static void read_sensing(reader given, fieldmap_loop *loop, fieldmap_calibration_curve *curve)
{
    fieldmap_sensing *out = &loop->sensing;
    double scan[5] = {0.0};
    int k;
    copy_of(&given, "into", 2, 9, out->into);
    copy_of(&given, "shift", 1, 3, out->shift);
    copy_of(&given, "back", 2, 9, out->back);
    copy_of(&given, "scan", 1, 5, scan);
    copy_of(&given, "chains", 2, 30, (double *)out->chains);
    out->scan_time = scan[0], out->latency = (int)scan[1];
    for (k = 0; k < 3; k++) out->averages[k] = scan[2 + k] < 1.0 ? 1 : (int)scan[2 + k];
    read_field_sensing(&given, loop, curve);
}

/* The control law: address of a function, 0 for none, -1 if the caller gives the outputs; controller, allocation, inverse. */
static void read_law(reader given, fieldmap_loop *out, fieldmap_inverse_map *inverse)
{
    PyObject *address = value_of(&given, "address"), *search = value_of(&given, "inverse");
    const long long number = address == NULL ? 0 : PyLong_AsLongLong(address);
    out->given = number == -1;
    out->function = number > 0 ? (fieldmap_control_function *)(uintptr_t)number : NULL;
    out->controller = (const fieldmap_controller *)held_of(&given, "controller", CONTROLLER);
    read_allocation(part_of(&given, "allocation"), &out->allocation, out->machine == NULL ? 0 : out->machine->n_coils);
    if (search != NULL && search != Py_None) {
        read_inverse(attributes_of(&given, search), inverse);
        inverse->allocation = &out->allocation;
        out->inverse = inverse;
    }
    require(out->controller != NULL && out->controller->outputs == (out->inverse == NULL ? out->allocation.n_outputs : 3),
            PyExc_ValueError, "the controller has other outputs than the allocation takes");
}

static void read_signals(reader given, fieldmap_loop *out, npy_intp coils, npy_intp outputs)
{
    const number_array references = points_of(&given, "references"), loads = numbers_of(&given, "loads", 2, ANY);
    const number_array scans = filled_numbers(&given, "scans", 2, ANY);
    const npy_intp samples = references.shape[0], sensors = out->field_sensing.sensors.count;
    out->samples = samples, out->disturbed = loads.shape[0], out->n_scans = scans.shape[0];
    require(loads.size == 6 * loads.shape[0] && scans.size == 3 * scans.shape[0], PyExc_TypeError,
            "loads must be (p or 1, 6), scans (k, 3)");
    require((loads.shape[0] == 1 || (loads.shape[0] > 1 && loads.shape[0] >= samples))
                && (out->sensing.scan_time <= 0.0 || out->n_scans >= 1),
            PyExc_ValueError, "there are fewer loads or scans than samples");
    out->references = references.at, out->disturbances = loads.at, out->scans = scans.at;
    out->feedforward = numbers_of(&given, "feedforward", 2, outputs * samples).at;
    out->noise = numbers_of(&given, "noise", 2, 3 * samples).at;
    out->voltage_noise = numbers_of(&given, "voltage_noise", 2, 3 * samples).at;
    out->current_noise = numbers_of(&given, "current_noise", 2, coils * samples).at;
    out->field_sensing.noise = numbers_of(&given, "field_noise", 2, sensors == 0 ? 0 : (2 * sensors + coils) * samples).at;
}

/* State, currents and memory that a run advances, and its room. */
static void read_room(reader *given, fieldmap_loop *out, npy_intp coils, npy_intp outputs)
{
    const number_array memory = filled_numbers(given, "memory", 1, ANY), rows = filled_numbers(given, "rows", 2, ANY);
    const npy_intp sensors = out->field_sensing.sensors.count;
    out->memory_size = (int)memory.size, out->memory = memory.at;
    out->max_rows = rows.shape[0], out->rows = rows.at;
    require(out->function != NULL || out->given || out->controller == NULL || memory.size == out->controller->states,
            PyExc_ValueError, "the memory is not that of the controller");
    require(out->machine == NULL || out->controller == NULL || rows.size == rows.shape[0] * (npy_intp)fieldmap_row_size(out),
            PyExc_TypeError, "rows must hold state, currents, commands, position and outputs, and what coupled coils add");
    out->progress = (fieldmap_progress *)filled_whole_of(given, "progress", sizeof(fieldmap_progress) / sizeof(int64_t));
    require(out->progress == NULL || (out->progress->rows >= 0 && out->progress->samples >= 0), PyExc_ValueError,
            "progress must not be negative");
    out->state = state_of(given, "state");
    out->load = filled_of(given, "load", 6);
    out->signals = filled_of(given, "seen", FIELDMAP_SIGNALS + (sensors == 0 ? 0 : sensors + coils));
    out->outputs = filled_of(given, "outputs", outputs);
    out->scratch = filled_of(given, "scratch", memory.size + 2 * outputs);
    out->currents = filled_of(given, "currents", coils);
    out->commands = filled_of(given, "commands", coils);
    out->waiting = filled_of(given, "waiting", coils);
    out->late = filled_of(given, "late", coils);
    out->voltages = filled_of(given, "voltages", coils);
}

static void read_loop(reader given, fieldmap_loop *out, fieldmap_inverse_map *inverse, fieldmap_calibration_curve *curve)
{
    npy_intp coils, outputs;
    reader ending = part_of(&given, "ending");
    out->contacts = whole_of(&ending, "contacts"), out->longest_saturation = whole_of(&ending, "longest_saturation");
    out->machine = machine_of(&given);
    read_timing(part_of(&given, "timing"), out);
    read_sensing(part_of(&given, "sensing"), out, curve);
    read_law(part_of(&given, "law"), out, inverse);
    if (PyErr_Occurred()) return;
    coils = out->machine->n_coils, outputs = out->controller->outputs;
    read_signals(part_of(&given, "signals"), out, coils, outputs);
    read_room(&given, out, coils, outputs);
}

/* Call one of the two functions of closed_loop.h on a run; returns an event. */
static PyObject *with_loop(PyObject *const *args, Py_ssize_t given, int (*function)(fieldmap_loop *))
{
    reader from = arguments(args, given, 1);
    fieldmap_inverse_map inverse;
    fieldmap_calibration_curve curve;
    fieldmap_loop loop = {0};
    int event = 0;
    read_loop(part_of(&from, "loop"), &loop, &inverse, &curve);
    if (!PyErr_Occurred()) {
        Py_BEGIN_ALLOW_THREADS
        event = function(&loop);
        Py_END_ALLOW_THREADS
    }
    return answer(&from, PyLong_FromLong(event));
}

/* loop_begin(loop), loop_run(loop): see fieldmap.core.closed_loop. */
static PyObject *loop_begin(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    (void)self;
    return with_loop(args, given, fieldmap_loop_begin);
}

static PyObject *loop_run(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    (void)self;
    return with_loop(args, given, fieldmap_loop_run);
}

#define CLOSED_LOOP_FUNCTIONS FUNCTION(inverse_along), FUNCTION(loop_begin), FUNCTION(loop_run)
#define CLOSED_LOOP_CONSTANTS \
    CONSTANT(GOES_ON), CONSTANT(FELL_OUT), CONSTANT(LEFT_ABOVE), CONSTANT(LEFT_SIDEWAYS), CONSTANT(NOT_A_NUMBER), \
    CONSTANT(HIT_FLOOR), CONSTANT(HIT_POLE), CONSTANT(HIT_TUBE), CONSTANT(SATURATED), CONSTANT(BEYOND_CURRENTS), \
    CONSTANT(CONTROLLER_FAILED), CONSTANT(OUTPUTS_NOT_FINITE), CONSTANT(PAUSED), CONSTANT(BEYOND)

#endif
