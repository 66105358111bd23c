/* instruments.h: sensor and converter for a position, converter and amplifier for a voltage, one sample at a time
 * (docs/theory/control.md (8) to (10)).
 *
 * A step of 0 does not round. All numbers are double.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_INSTRUMENTS_H
#define FIELDMAP_INSTRUMENTS_H

#include <math.h>

/* From a position to the position that the controller reads. zero: m, at 0 V; scale: m/V; of the sensor's output: step and
 * limits, V; of the converter: gain error, relative, offset error, V, step and limits, V. */
typedef struct fieldmap_chain {
    double zero, scale, sensor_step, sensor_lower, sensor_upper;
    double gain_error, offset_error, input_step, input_lower, input_upper;
} fieldmap_chain;

/* From a voltage of the controller to a current. Of the converter: step and limits, V; of the amplifier: gain, A/V, offset,
 * A, and limits of the current, A. */
typedef struct fieldmap_drive {
    double output_step, lower, upper, gain, offset, current_lower, current_upper;
} fieldmap_drive;

/* A value clipped to limits; NaN gives the lower limit. */
static inline double fieldmap_within(double value, double lower, double upper)
{
    const double above = value > lower ? value : lower;
    return above < upper ? above : upper;
}

/* The nearest multiple of a step; halves are rounded up. */
static inline double fieldmap_round_to_step(double value, double step)
{
    return step == 0.0 ? value : step * floor(value / step + 0.5);
}

/* An ideal converter limits, then rounds. */
static inline double fieldmap_convert(double value, double step, double lower, double upper)
{
    return fieldmap_round_to_step(fieldmap_within(value, lower, upper), step);
}

/* The position that the controller reads. Noise of the sensor is in `position` already. */
static inline double fieldmap_measure(const fieldmap_chain *chain, double position, double voltage_noise)
{
    const double volts = (position - chain->zero) / chain->scale;
    const double sensed = fieldmap_convert(volts, chain->sensor_step, chain->sensor_lower, chain->sensor_upper);
    const double disturbed = sensed * (1.0 + chain->gain_error) + chain->offset_error + voltage_noise;
    return chain->zero
        + chain->scale * fieldmap_convert(disturbed, chain->input_step, chain->input_lower, chain->input_upper);
}

/* The current that flows for a voltage of the controller. */
static inline double fieldmap_driven(const fieldmap_drive *drive, double voltage, double current_noise)
{
    const double shown = fieldmap_convert(voltage, drive->output_step, drive->lower, drive->upper);
    return fieldmap_within(drive->gain * shown + drive->offset + current_noise, drive->current_lower, drive->current_upper);
}

/* Reading of a scanning sensor: the mean of its last `averages` scans, delayed by `latency` scans, and held. scans[n * step]:
 * `count` readings; at: time in units of the scan time. Before the first mean is available, the reading is the first scan. */
static inline double fieldmap_held_scan(const double *scans, long count, int step, double at, int averages, int latency)
{
    long last = (long)floor(at + 1e-9) - latency, n;
    double total = 0.0;
    last -= ((last + 1) % averages + averages) % averages;
    if (last > count - 1) last = count - 1;
    if (last < averages - 1) return scans[0];
    for (n = last - averages + 1; n <= last; n++) total += scans[n * step];
    return total / averages;
}

#endif
