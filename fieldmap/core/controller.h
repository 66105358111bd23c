/* controller.h: every sampled controller as one linear block with limits (docs/theory/closed_loop.md (5)).
 *
 *     u = C xi + D v + f     s = u within its limits     xi <- A xi + B v + E (s - f) + F f
 *
 * v[7]: reference[3] and measured position[3] of the sensed point, both m in the frame of the map, and 1. xi: memory.
 * f: feed-forward. E and F feed the applied outputs s to an observer; E also feeds them to an integral that tracks its limit.
 * In fm_real (real.h): double, or single precision for microcontrollers with FIELDMAP_REAL float.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_CONTROLLER_H
#define FIELDMAP_CONTROLLER_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "instruments.h"
#include "real.h"

enum { FIELDMAP_SIGNALS = 7 };

/* A to F: the matrices, row by row. A scheduled controller has one of each for `nodes` equidistant values of v[signal], one
 * after the other, and interpolates linearly between them. first, step: v[signal] at the first node, and its step from node to
 * node. lower, upper: limits of the outputs. hold: one number for each number of the memory. It is the index of an output if
 * the memory is an integral that must not drive this output further beyond a limit, otherwise -1. */
typedef struct fieldmap_controller {
    int nodes, states, outputs, signal;
    fm_real first, step;
    const fm_real *A, *B, *C, *D, *E, *F, *lower, *upper;
    const int64_t *hold;
} fieldmap_controller;

/* Position of a signal between two nodes. node: the lower one; share: weight of the upper one. */
typedef struct fieldmap_between {
    int node;
    fm_real share;
} fieldmap_between;

static inline fieldmap_between fieldmap_node(const fieldmap_controller *of, const fm_real *v)
{
    fieldmap_between found = {0, FM(0)};
    if (of->nodes > 1) {
        const fm_real at = FM(fieldmap_within((v[of->signal] - of->first) / of->step, 0.0, of->nodes - 1.0));
        found.node = (int)at < of->nodes - 2 ? (int)at : of->nodes - 2;
        found.share = at - FM(found.node);
    }
    return found;
}

/* Product of row i of a matrix (rows, columns), interpolated between nodes, and a vector. */
static inline fm_real fieldmap_row_times(
    const fm_real *stack, fieldmap_between at, int rows, int columns, int i, const fm_real *vector)
{
    const size_t matrix = (size_t)rows * (size_t)columns;
    const fm_real *row = stack + (size_t)at.node * matrix + (size_t)i * (size_t)columns;
    fm_real sum = FM(0);
    int k;
    if (at.share == FM(0)) {
        for (k = 0; k < columns; k++) sum += row[k] * vector[k];
    } else {
        for (k = 0; k < columns; k++) sum += ((FM(1) - at.share) * row[k] + at.share * row[matrix + (size_t)k]) * vector[k];
    }
    return sum;
}

/* Output j before feed-forward and limits. */
static inline fm_real fieldmap_wanted_output(
    const fieldmap_controller *of, fieldmap_between at, int j, const fm_real *memory, const fm_real *v)
{
    return fieldmap_row_times(of->C, at, of->outputs, of->states, j, memory)
        + fieldmap_row_times(of->D, at, of->outputs, FIELDMAP_SIGNALS, j, v);
}

/* Number i of the memory after this sample. without[outputs]: the limited outputs minus the feed-forward. */
static inline fm_real fieldmap_next_memory(const fieldmap_controller *of, fieldmap_between at, int i, const fm_real *memory,
                                          const fm_real *v, const fm_real *without, const fm_real *feedforward)
{
    return fieldmap_row_times(of->A, at, of->states, of->states, i, memory)
        + fieldmap_row_times(of->B, at, of->states, FIELDMAP_SIGNALS, i, v)
        + fieldmap_row_times(of->E, at, of->states, of->outputs, i, without)
        + fieldmap_row_times(of->F, at, of->states, of->outputs, i, feedforward);
}

/* Length of the scratch array. */
static inline int fieldmap_controller_scratch(const fieldmap_controller *of)
{
    return of->states + 2 * of->outputs;
}

/* Fill outputs[], feed-forward included, and advance memory[]. Returns whether a limit changed an output. */
static inline int fieldmap_control(const fieldmap_controller *of, const fm_real *v, const fm_real *feedforward, fm_real *memory,
                                   fm_real *scratch, fm_real *outputs)
{
    const int n = of->states, m = of->outputs;
    const fieldmap_between at = fieldmap_node(of, v);
    fm_real *without = scratch + n, *beyond = without + m;
    int i, j, held = 0;
    for (j = 0; j < m; j++) {
        const fm_real wanted = fieldmap_wanted_output(of, at, j, memory, v) + feedforward[j];
        outputs[j] = FM(fieldmap_within(wanted, of->lower[j], of->upper[j]));
        without[j] = outputs[j] - feedforward[j];
        beyond[j] = wanted - outputs[j];
        held |= wanted != outputs[j];
    }
    for (i = 0; i < n; i++) scratch[i] = fieldmap_next_memory(of, at, i, memory, v, without, feedforward);
    for (i = 0; i < n; i++) {
        const int64_t output = of->hold[i];
        if (output >= 0) {
            /* Coefficient of this number of the memory in its output. */
            const fm_real *by_memory = of->C + ((size_t)at.node * (size_t)m + (size_t)output) * (size_t)n + (size_t)i;
            fm_real drives = by_memory[0];
            if (at.share != FM(0)) drives = (FM(1) - at.share) * drives + at.share * by_memory[(size_t)m * (size_t)n];
            if (beyond[output] * drives * (scratch[i] - memory[i]) > FM(0)) continue;
        }
        memory[i] = scratch[i];
    }
    return held;
}

/* Fill feedforward[] so that the controller gives the outputs wanted[] while the sensed point is at its reference[3], and
 * advance memory[]. The feed-forward is wanted[] minus the outputs of the controller alone. */
static inline void fieldmap_quiet_feedforward(const fieldmap_controller *of, const fm_real *reference, const fm_real *wanted,
                                              fm_real *memory, fm_real *scratch, fm_real *feedforward)
{
    fm_real v[FIELDMAP_SIGNALS] = {FM(0)}, *without = scratch + of->states;
    fieldmap_between at;
    int i, j;
    for (i = 0; i < 3; i++) v[i] = v[3 + i] = reference[i];
    v[6] = FM(1);
    at = fieldmap_node(of, v);
    for (j = 0; j < of->outputs; j++) {
        feedforward[j] = wanted[j] - fieldmap_wanted_output(of, at, j, memory, v);
        without[j] = wanted[j] - feedforward[j];
    }
    for (i = 0; i < of->states; i++) scratch[i] = fieldmap_next_memory(of, at, i, memory, v, without, feedforward);
    for (i = 0; i < of->states; i++) memory[i] = scratch[i];
}

#endif
