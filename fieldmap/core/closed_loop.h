/* closed_loop.h: a levitated magnet in closed loop, from sensor to current to motion and back, at two rates
 * (docs/theory/closed_loop.md (6)).
 *
 * Every control period: sense, compute, allocate, convert. The new currents are commanded `delay` mechanical steps later.
 * Every mechanical step: the currents advance, then the body. A run can pause between sensing and computing, so that the caller
 * gives the outputs, and go on from there. A loop that the caller writes, sample by sample, thus runs the same code as a whole
 * run. All numbers are double.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_CLOSED_LOOP_H
#define FIELDMAP_CLOSED_LOOP_H

#include "calibration_curve.h"
#include "controller.h"
#include "field_sensors.h"
#include "inverse.h"

/* Events that end a run. FIELDMAP_GOES_ON is no event. FIELDMAP_PAUSED is no end: the caller must give the outputs of the next
 * sample. */
enum {
    FIELDMAP_GOES_ON, FIELDMAP_FELL_OUT, FIELDMAP_LEFT_ABOVE, FIELDMAP_LEFT_SIDEWAYS, FIELDMAP_NOT_A_NUMBER,
    FIELDMAP_HIT_FLOOR, FIELDMAP_HIT_POLE, FIELDMAP_HIT_TUBE, FIELDMAP_SATURATED, FIELDMAP_BEYOND_CURRENTS,
    FIELDMAP_CONTROLLER_FAILED, FIELDMAP_OUTPUTS_NOT_FINITE, FIELDMAP_PAUSED
};

/* Another flag for `touched`: currents lay outside the table or the model of the iron. */
enum { FIELDMAP_BEYOND = 8 };

/* A controller function of the caller. It fills the outputs, may change its state, and returns 0. Any other number ends the
 * run. measured: position of the sensed point; with field sensors and no estimator their readings, T, and the measured
 * currents, A. */
typedef int fieldmap_control_function(
    double time, const double *measured, const double *reference, double *state, double *outputs);

/* Three sensors. Without errors they read into * p + shift at the sensed point p. chains: the instruments that a reading
 * passes; back: the inverse of `into`. scan_time: time between scans, s, or 0 for sensors that read at the moment of sampling;
 * averages: number of scans that each sensor averages; latency: delay of the average, in scans. */
typedef struct fieldmap_sensing {
    double into[9], shift[3], back[9], scan_time;
    int latency, averages[3];
    fieldmap_chain chains[3];
} fieldmap_sensing;

/* Field sensors in the place of the position sensors; none if their count is 0. chains: the electronics of each, from a flux
 * density, T, to the one that the controller reads. latency: samples by which readings come late, with the currents of that
 * moment. noise[samples * (2 * count + n_coils)]: of the elements, T, of their converters, V, and of the measured currents, A.
 * history[(latency + 1) * (count + n_coils)]: readings and measured currents of the last samples. curve: finds the height of
 * the sensed point from sensor `sensor`; its x and y are assumed to be `beside`. NULL: there is no estimator. */
typedef struct fieldmap_field_sensing {
    fieldmap_field_sensors sensors;
    const fieldmap_chain *chains;
    int latency, sensor;
    const double *noise;
    double *history, beside[2];
    const fieldmap_calibration_curve *curve;
} fieldmap_field_sensing;

/* State of a run. samples, steps, rows: numbers of control samples, mechanical steps and recorded rows so far. held: number of
 * consecutive periods in which a limit was active. sensed: whether the next sample is sensed already. answer: the number that
 * the controller function returned. scan: index of the next scan. touched: flags of all contacts so far. within: whether the
 * currents lie in the table or the model of the iron. */
typedef struct fieldmap_progress {
    int64_t samples, steps, rows, held, sensed, answer, scan, touched, within;
} fieldmap_progress;

/* A run. step: mechanical step, s; per_period, delay: mechanical steps of a control period and of the delay; every: control
 * periods per recorded row; contacts: flags of the contacts that end the run; longest_saturation: periods with an active limit
 * that end the run, 0 for never.
 *
 * The outputs come from `function` unless it is NULL, or from the caller if `given` is 1; both are limited like the
 * outputs of `controller`. Otherwise they come from `controller`. They go to the allocation, or are forces for `inverse` unless
 * it is NULL.
 *
 * Arrays with a row for each sample: references[3], feedforward[outputs], noise[3] of the position, voltage_noise[3] of the
 * input converters, current_noise[n_coils]; disturbances[6] has `disturbed` rows, or one for all samples.
 * scans[3 * n_scans]: the caller puts the noise there, and the run adds the readings.
 *
 * The run advances state, currents, memory and load. commands: the present commanded currents; waiting: commands of the last
 * sample; late: commands of the sample before. signals: input of the controller, reference and measured position first, then
 * the readings of field sensors and the measured currents. scratch: as long as the memory and twice the outputs. rows: at most
 * max_rows rows of state, currents, commands, measured position and outputs, and of coupled coils voltages and temperatures. */
typedef struct fieldmap_loop {
    fieldmap_machine *machine;
    double step;
    int64_t per_period, delay, every, contacts, longest_saturation;
    fieldmap_sensing sensing;
    fieldmap_field_sensing field_sensing;
    const fieldmap_controller *controller;
    fieldmap_control_function *function;
    int given, memory_size;
    fieldmap_allocation allocation;
    const fieldmap_inverse_map *inverse;
    int64_t samples, disturbed, n_scans, max_rows;
    const double *references, *feedforward, *disturbances, *noise, *voltage_noise, *current_noise;
    double *scans, *currents, *memory, *load, *commands, *waiting, *late, *signals, *outputs, *scratch, *voltages, *rows;
    fieldmap_state *state;
    fieldmap_progress *progress;
} fieldmap_loop;

/* The event of a body that left the map. */
static inline int fieldmap_way_out(const fieldmap *map, int status, double z)
{
    if (status == FIELDMAP_NOT_FINITE || z != z) return FIELDMAP_NOT_A_NUMBER;
    if (z < map->lower[2]) return FIELDMAP_FELL_OUT;
    return z > map->lower[2] + map->cells[2] / map->inverse[2] ? FIELDMAP_LEFT_ABOVE : FIELDMAP_LEFT_SIDEWAYS;
}

/* The event of a contact. ends: flags of present contacts that end a run. */
static inline int fieldmap_hit(int64_t ends)
{
    if (ends & FIELDMAP_ON_FLOOR) return FIELDMAP_HIT_FLOOR;
    if (ends & FIELDMAP_ON_CEILING) return FIELDMAP_HIT_POLE;
    return ends & FIELDMAP_ON_WALL ? FIELDMAP_HIT_TUBE : FIELDMAP_GOES_ON;
}

/* Add the readings of the sensors to the scans between the times start and start + h, in which the sensed point moves from
 * before[3] to after[3]. Scan k is taken at k * scan_time. */
static inline void fieldmap_add_scans(fieldmap_loop *loop, const double *before, const double *after, double start, double h)
{
    const fieldmap_sensing *sensing = &loop->sensing;
    int64_t k = loop->progress->scan;
    int i, j;
    for (; k < loop->n_scans && (double)k * sensing->scan_time <= start + h + 1e-12; k++) {
        const double share = ((double)k * sensing->scan_time - start) / h;
        for (i = 0; i < 3; i++) {
            double value = sensing->shift[i];
            for (j = 0; j < 3; j++) value += sensing->into[3 * i + j] * (before[j] + share * (after[j] - before[j]));
            loop->scans[3 * k + i] += value;
        }
    }
    loop->progress->scan = k;
}

/* Read the field sensors at a sample, and fill the measured position in the signals of the controller, NaN without an
 * estimator, and the readings and currents after the signals. */
static inline void fieldmap_sense_field(fieldmap_loop *loop, int64_t sample)
{
    const fieldmap_field_sensing *sensing = &loop->field_sensing;
    const fieldmap_machine *machine = loop->machine;
    const int count = sensing->sensors.count, n = machine->n_coils, width = count + n, rows = sensing->latency + 1;
    const int64_t late = sample > sensing->latency ? sample - sensing->latency : 0;
    const double *noise = sensing->noise + sample * (2 * count + n);
    double *now = sensing->history + sample % rows * width, *seen = loop->signals + FIELDMAP_SIGNALS, r[9];
    int k;
    fieldmap_rotation(loop->state->turn, r);
    fieldmap_read_sensors(&sensing->sensors, &machine->field, &machine->body.magnetic, loop->state->position, r, now);
    for (k = 0; k < count; k++) now[k] = fieldmap_measure(sensing->chains + k, now[k] + noise[k], noise[count + k]);
    for (k = 0; k < n; k++) now[count + k] = loop->currents[k] + noise[2 * count + k];
    for (k = 0; k < width; k++) seen[k] = sensing->history[late % rows * width + k];
    for (k = 0; k < 2; k++) loop->signals[3 + k] = sensing->beside[k];
    loop->signals[5] = sensing->curve == NULL
        ? NAN
        : fieldmap_height_of_reading(sensing->curve, seen[sensing->sensor], seen + count);
}

/* Measure the sensed point at a sample, and fill the reference and the measured position in the signals of the controller. */
static inline void fieldmap_sense(fieldmap_loop *loop, int64_t sample, double time)
{
    const fieldmap_sensing *sensing = &loop->sensing;
    double point[3], read[3], seen[3];
    int i;
    for (i = 0; i < 3; i++) loop->signals[i] = loop->references[3 * sample + i];
    if (loop->field_sensing.sensors.count > 0) {
        fieldmap_sense_field(loop, sample);
        return;
    }
    fieldmap_sensed_point(loop->machine, loop->state, point);
    for (i = 0; i < 3; i++) {
        double value = sensing->shift[i] + loop->noise[3 * sample + i] + fieldmap_dot(sensing->into + 3 * i, point);
        if (sensing->scan_time > 0.0)
            value = fieldmap_held_scan(loop->scans + i, (long)loop->n_scans, 3, time / sensing->scan_time,
                                       sensing->averages[i], sensing->latency);
        read[i] = fieldmap_measure(sensing->chains + i, value, loop->voltage_noise[3 * sample + i]) - sensing->shift[i];
    }
    fieldmap_to_map(sensing->back, read, seen);
    for (i = 0; i < 3; i++) loop->signals[3 + i] = seen[i];
}

/* Fill the outputs of the controller function or of the caller, with feed-forward and limits. Returns an event. */
static inline int fieldmap_own_outputs(fieldmap_loop *loop, double time, const double *feedforward, int *held)
{
    const fieldmap_controller *limits = loop->controller;
    const int estimated = loop->field_sensing.sensors.count == 0 || loop->field_sensing.curve != NULL;
    const double *measured = loop->signals + (estimated ? 3 : FIELDMAP_SIGNALS);
    int j;
    if (loop->function != NULL) {
        /* If the function fails, the caller shows the memory that it was called with. */
        for (j = 0; j < loop->memory_size; j++) loop->scratch[j] = loop->memory[j];
        loop->progress->answer = loop->function(time, measured, loop->signals, loop->memory, loop->outputs);
        if (loop->progress->answer != 0) return FIELDMAP_CONTROLLER_FAILED;
    }
    for (j = 0; j < limits->outputs; j++) {
        const double wanted = loop->outputs[j] + feedforward[j];
        if (!isfinite(loop->outputs[j])) return FIELDMAP_OUTPUTS_NOT_FINITE;
        loop->outputs[j] = fieldmap_within(wanted, limits->lower[j], limits->upper[j]);
        *held |= wanted != loop->outputs[j];
    }
    return FIELDMAP_GOES_ON;
}

/* Fill the voltages of the coils from the outputs. With an inverse map the outputs are forces at the measured position. */
static inline void fieldmap_to_coils(const fieldmap_loop *loop)
{
    const fieldmap_inverse_map *inverse = loop->inverse;
    double point[3];
    int k;
    if (inverse == NULL) {
        fieldmap_allocate(&loop->allocation, loop->outputs, loop->voltages);
        return;
    }
    fieldmap_sensed_point(loop->machine, inverse->believed, point);
    for (k = 0; k < 3; k++) inverse->believed->position[k] += loop->signals[3 + k] - point[k];
    fieldmap_find_signals(inverse, loop->outputs);
    fieldmap_allocate(&loop->allocation, inverse->signals, loop->voltages);
}

/* Compute, allocate, convert: fill `waiting`. held: whether a limit was active. Returns an event. */
static inline int fieldmap_compute(fieldmap_loop *loop, int64_t sample, double time, int *held)
{
    const fieldmap_machine *machine = loop->machine;
    const double *feedforward = loop->feedforward + sample * loop->controller->outputs;
    const double *noise = loop->current_noise + sample * machine->n_coils;
    int k, event = FIELDMAP_GOES_ON;
    *held = 0;
    if (loop->function != NULL || loop->given)
        event = fieldmap_own_outputs(loop, time, feedforward, held);
    else
        *held = fieldmap_control(loop->controller, loop->signals, feedforward, loop->memory, loop->scratch, loop->outputs);
    if (event != FIELDMAP_GOES_ON) return event;
    fieldmap_to_coils(loop);
    for (k = 0; k < machine->n_coils; k++) {
        const fieldmap_drive *drive = machine->drives + k;
        *held |= loop->voltages[k] > drive->upper || loop->voltages[k] < drive->lower;
        loop->waiting[k] = fieldmap_driven(drive, loop->voltages[k], noise[k]);
    }
    return event;
}

/* Numbers of a recorded row. */
static inline int64_t fieldmap_row_size(const fieldmap_loop *loop)
{
    const int n = loop->machine->n_coils;
    return FIELDMAP_STATE + (loop->machine->electrical == NULL ? 2 : 4) * n + 3 + loop->controller->outputs;
}

static inline void fieldmap_record(fieldmap_loop *loop)
{
    const double *state = (const double *)loop->state;
    const int n = loop->machine->n_coils, m = loop->controller->outputs;
    const fieldmap_electrical *electrical = loop->machine->electrical;
    double *row = loop->rows + loop->progress->rows * fieldmap_row_size(loop);
    int k;
    for (k = 0; k < FIELDMAP_STATE; k++) *row++ = state[k];
    for (k = 0; k < n; k++) *row++ = loop->currents[k];
    for (k = 0; k < n; k++) *row++ = loop->commands[k];
    for (k = 0; k < 3; k++) *row++ = loop->signals[3 + k];
    for (k = 0; k < m; k++) *row++ = loop->outputs[k];
    for (k = 0; electrical != NULL && k < n; k++) row[k] = electrical->voltage[k], row[n + k] = electrical->temperature[k];
    loop->progress->rows++;
}

/* Advance the currents by one step, and the weights of the fields if a current changed. Returns whether one changed. held: set
 * if a supply limited one. */
static inline int fieldmap_move_currents(fieldmap_loop *loop, int *held)
{
    fieldmap_machine *machine = loop->machine;
    int held_now, moved;
    fieldmap_advance_currents(machine->windings, machine->n_coils, loop->commands, loop->currents, &held_now, &moved);
    if (moved) loop->progress->within = fieldmap_machine_follow(machine, loop->currents);
    *held |= held_now;
    return moved;
}

static inline int fieldmap_load_now(fieldmap_loop *loop, int *touched)
{
    return fieldmap_load(&loop->machine->field, &loop->machine->body, loop->state, loop->load, touched);
}

/* Mechanical step `number` of a period whose first step is `first`. at_once: the currents follow commands without delay. held:
 * set if a supply limited a current. Returns an event. */
static inline int fieldmap_mechanical_step(fieldmap_loop *loop, int64_t first, int64_t number, int at_once, int *held)
{
    const int scanning = loop->sensing.scan_time > 0.0;
    fieldmap_machine *machine = loop->machine;
    fieldmap_progress *progress = loop->progress;
    double before[3], after[3];
    int k, touched, ignored = 0, within = 1, status, event;
    if (number == loop->delay || (number == 0 && loop->delay == loop->per_period)) {
        const double *now = loop->delay == loop->per_period ? loop->late : loop->waiting;
        for (k = 0; k < machine->n_coils; k++) loop->commands[k] = now[k];
        if (at_once && fieldmap_move_currents(loop, &ignored)) fieldmap_load_now(loop, &touched);
    }
    if (machine->electrical == NULL) fieldmap_move_currents(loop, held);
    if (!progress->within) {
        progress->touched |= FIELDMAP_BEYOND;
        if (loop->contacts & FIELDMAP_BEYOND) return FIELDMAP_BEYOND_CURRENTS;
    }
    if (scanning) fieldmap_sensed_point(machine, loop->state, before);
    if (machine->electrical == NULL) {
        status = fieldmap_step(&machine->field, &machine->body, loop->state, loop->load, loop->step, 2, &touched);
    } else {
        status = fieldmap_coupled_step(machine, loop->step, loop->commands, loop->state, loop->currents, loop->load, held,
                                       &within, &touched);
        progress->within = within;
    }
    progress->touched |= touched;
    progress->steps++;
    if (status != FIELDMAP_OK) return fieldmap_way_out(machine->field.map, status, loop->state->position[2]);
    event = fieldmap_hit(touched & loop->contacts);
    if (event != FIELDMAP_GOES_ON) return event;
    if (scanning) {
        fieldmap_sensed_point(machine, loop->state, after);
        fieldmap_add_scans(loop, before, after, (double)(first + number) * loop->step, loop->step);
    }
    return FIELDMAP_GOES_ON;
}

/* Begin a run: compute the load of the state, and take the first scan. Returns an event, if the body is outside already. */
static inline int fieldmap_loop_begin(fieldmap_loop *loop)
{
    fieldmap_machine *machine = loop->machine;
    double point[3];
    int i, touched, status;
    for (i = 0; i < 3; i++)
        machine->body.force[i] = loop->disturbances[i], machine->body.torque[i] = loop->disturbances[3 + i];
    if (loop->sensing.scan_time > 0.0) {
        fieldmap_sensed_point(machine, loop->state, point);
        fieldmap_add_scans(loop, point, point, 0.0, 1e-9 * loop->step);
    }
    loop->progress->within = fieldmap_machine_follow(machine, loop->currents);
    status = fieldmap_load_now(loop, &touched);
    if (status == FIELDMAP_OK && machine->electrical != NULL) status = fieldmap_coupled_begin(machine, loop->state, loop->currents);
    return status == FIELDMAP_OK ? FIELDMAP_GOES_ON
                                 : fieldmap_way_out(machine->field.map, status, loop->state->position[2]);
}

/* Run on from the end of the last call until the end of the run or an event. Returns the event. If the caller gives the
 * outputs, the run pauses at each sample. The body keeps the disturbance of the last sample. */
static inline int fieldmap_loop_run(fieldmap_loop *loop)
{
    fieldmap_machine *machine = loop->machine;
    fieldmap_progress *progress = loop->progress;
    const int at_once = machine->electrical == NULL && fieldmap_at_once(machine->windings, machine->n_coils);
    int k, held, event, touched;
    while (progress->samples < loop->samples) {
        const int64_t sample = progress->samples, first = progress->steps;
        const double time = (double)first * loop->step;
        int64_t number;
        if (!progress->sensed) {
            fieldmap_sense(loop, sample, time);
            progress->sensed = 1;
            if (loop->given) return FIELDMAP_PAUSED;
        }
        for (k = 0; k < machine->n_coils; k++) loop->late[k] = loop->waiting[k];
        event = fieldmap_compute(loop, sample, time, &held);
        if (event != FIELDMAP_GOES_ON) return event;
        if (loop->disturbed > 1 && sample > 0) {
            const double *load = loop->disturbances + 6 * sample;
            for (k = 0; k < 3; k++) machine->body.force[k] = load[k], machine->body.torque[k] = load[3 + k];
            fieldmap_load_now(loop, &touched);
        }
        if (sample % loop->every == 0 && progress->rows < loop->max_rows) fieldmap_record(loop);
        for (number = 0; number < loop->per_period; number++) {
            event = fieldmap_mechanical_step(loop, first, number, at_once, &held);
            if (event != FIELDMAP_GOES_ON) return event;
        }
        if (machine->electrical != NULL) fieldmap_warm(machine->electrical, (double)loop->per_period * loop->step);
        progress->samples = sample + 1, progress->sensed = 0;
        progress->held = held ? progress->held + 1 : 0;
        if (loop->longest_saturation > 0 && progress->held >= loop->longest_saturation) return FIELDMAP_SATURATED;
    }
    return FIELDMAP_GOES_ON;
}

#endif
