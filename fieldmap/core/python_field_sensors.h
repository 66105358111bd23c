/* python_field_sensors.h: field sensors and calibration curves, for Python: see fieldmap.core.field_sensors.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_FIELD_SENSORS_H
#define FIELDMAP_PYTHON_FIELD_SENSORS_H

#include "calibration_curve.h"
#include "field_sensors.h"
#include "python_instruments.h"
#include "python_machine.h"

static void read_field_sensors(reader given, npy_intp sets, fieldmap_field_sensors *out)
{
    const number_array places = numbers_of(&given, "places", 2, ANY);
    out->count = (int)places.shape[0], out->sensors = (const fieldmap_field_sensor *)places.at;
    require(places.shape[1] == 6 && places.shape[0] > 0 && places.shape[0] <= BODY_PARTS, PyExc_TypeError,
            "places must be (s, 6)");
    out->shares = numbers_of(&given, "shares", 2, out->count * sets).at;
    out->answers = (const fieldmap *)held_or_none(&given, "answers", MAP);
    require(out->answers == NULL || fieldmap_sets(out->answers) == out->count, PyExc_ValueError,
            "answers must have a set for each sensor");
}

static void read_calibration_curve(reader given, fieldmap_calibration_curve *out)
{
    const number_array per_ampere = numbers_of(&given, "per_ampere", 1, ANY), readings = numbers_of(&given, "readings", 1, ANY);
    out->nodes = (int)readings.size, out->n_coils = (int)per_ampere.size;
    require(readings.size >= 2 && readings.size <= BODY_PARTS, PyExc_TypeError, "a curve has two nodes or more");
    out->constant = real_of(&given, "constant");
    out->per_ampere = per_ampere.at, out->readings = readings.at;
    out->heights = numbers_of(&given, "heights", 1, readings.size).at;
    out->slopes = numbers_of(&given, "slopes", 1, readings.size).at;
}

/* machine_readings(machine, sensors, state, out): fill out (s,) at a state in the present field; the status of the map. */
static PyObject *machine_readings(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 4);
    const fieldmap_machine *machine = machine_of(&from);
    fieldmap_field_sensors sensors;
    const fieldmap_state *state;
    double *out, r[9];
    (void)self;
    read_field_sensors(part_of(&from, "sensors"), machine == NULL ? 0 : fieldmap_sets(machine->field.map), &sensors);
    state = state_of(&from, "state"), out = filled_of(&from, "out", sensors.count);
    if (PyErr_Occurred()) return nothing(&from);
    fieldmap_rotation(state->turn, r);
    return answer(&from, PyLong_FromLong(fieldmap_read_sensors(&sensors, &machine->field, &machine->body.magnetic,
                                                               state->position, r, out)));
}

/* heights_of_readings(curve, readings (p,), currents (p, n), out (p,)) */
static PyObject *heights_of_readings(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 4);
    fieldmap_calibration_curve curve = {0};
    number_array readings;
    const double *currents;
    double *out;
    npy_intp p;
    (void)self;
    read_calibration_curve(part_of(&from, "curve"), &curve);
    readings = numbers_of(&from, "readings", 1, ANY);
    currents = numbers_of(&from, "currents", 2, readings.size * curve.n_coils).at;
    out = filled_of(&from, "out", readings.size);
    for (p = 0; p < readings.size && !PyErr_Occurred(); p++)
        out[p] = fieldmap_height_of_reading(&curve, readings.at[p], currents + p * curve.n_coils);
    return nothing(&from);
}

#define FIELD_SENSOR_FUNCTIONS FUNCTION(machine_readings), FUNCTION(heights_of_readings)

#endif
