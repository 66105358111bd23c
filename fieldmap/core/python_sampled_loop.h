/* python_sampled_loop.h: closed loops of sampled linear plants, for Python: see fieldmap.core.sampled_loop.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_SAMPLED_LOOP_H
#define FIELDMAP_PYTHON_SAMPLED_LOOP_H

#include "python_controller.h"
#include "python_instruments.h"
#include "sampled_loop.h"

/* A signal of (runs or 1, samples or 1) numbers, with its strides by run and by sample; 0 for a constant. */
typedef struct loop_signal {
    const double *numbers;
    npy_intp by_run, by_sample;
} loop_signal;

typedef struct asked_loop {
    fieldmap_plant plant;
    const fieldmap_controller *controller;
    fieldmap_loop_instruments instruments;
    loop_signal reference, position_noise, voltage_noise, current_noise, disturbance;
    const double *memory;
    double *y, *u;
    npy_intp runs, samples;
} asked_loop;

static double at_sample(const loop_signal *signal, npy_intp run, npy_intp n)
{
    return signal->numbers[run * signal->by_run + n * signal->by_sample];
}

static void read_loop_signal(reader *from, const char *name, const asked_loop *of, loop_signal *out)
{
    const number_array signal = numbers_of(from, name, 2, ANY);
    const npy_intp rows = signal.shape[0], columns = signal.shape[1];
    require((rows == 1 || rows == of->runs) && (columns == 1 || columns == of->samples), PyExc_TypeError,
            "signals must be (runs or 1, samples or 1)");
    out->numbers = signal.at, out->by_run = rows > 1 ? columns : 0, out->by_sample = columns > 1;
}

/* A plant of A (n, n), B (n,) and C (n,). */
static void read_plant(reader given, fieldmap_plant *out)
{
    const number_array B = numbers_of(&given, "B", 1, ANY);
    out->states = (int)B.size, out->B = B.at;
    out->A = numbers_of(&given, "A", 2, B.size * B.size).at;
    out->C = numbers_of(&given, "C", 1, B.size).at;
}

/* chain (10,), drive (7,), position and output: the numbers of the structures, in their order. */
static void read_loop_instruments(reader given, fieldmap_loop_instruments *out)
{
    copy_of(&given, "chain", 1, CHAIN_NUMBERS, (double *)(void *)&out->chain);
    copy_of(&given, "drive", 1, DRIVE_NUMBERS, (double *)(void *)&out->drive);
    out->position = real_of(&given, "position"), out->output = real_of(&given, "output");
}

static void read_loop_signals(reader given, asked_loop *of)
{
    read_loop_signal(&given, "reference", of, &of->reference);
    read_loop_signal(&given, "position_noise", of, &of->position_noise);
    read_loop_signal(&given, "voltage_noise", of, &of->voltage_noise);
    read_loop_signal(&given, "current_noise", of, &of->current_noise);
    read_loop_signal(&given, "disturbance", of, &of->disturbance);
}

/* A run from rest and from the given memory. work: room for a state, a memory and scratch. */
static void run_loop(const asked_loop *of, npy_intp run, double *work)
{
    double *x = work, *memory = x + of->plant.states, *scratch = memory + of->controller->states;
    npy_intp n;
    int i;
    for (i = 0; i < of->plant.states; i++) x[i] = 0.0;
    for (i = 0; i < of->controller->states; i++) memory[i] = of->memory[i];
    for (n = 0; n < of->samples; n++) {
        const fieldmap_loop_inputs in = {
            at_sample(&of->reference, run, n), at_sample(&of->position_noise, run, n), at_sample(&of->voltage_noise, run, n),
            at_sample(&of->current_noise, run, n), at_sample(&of->disturbance, run, n)};
        const npy_intp at = run * of->samples + n;
        of->y[at] = fieldmap_loop_sample(&of->plant, of->controller, &of->instruments, &in, x, memory, scratch, of->u + at);
    }
}

/* sampled_loop(plant, controller, instruments, signals, memory (n,), y (runs, samples), u (runs, samples)) */
static PyObject *sampled_loop(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    reader from = arguments(args, given, 7), signals;
    asked_loop of = {0};
    number_array y;
    double *work = NULL;
    npy_intp run;
    (void)self;
    read_plant(part_of(&from, "plant"), &of.plant);
    of.controller = (const fieldmap_controller *)held_of(&from, "controller", CONTROLLER);
    read_loop_instruments(part_of(&from, "instruments"), &of.instruments);
    signals = part_of(&from, "signals");
    of.memory = numbers_of(&from, "memory", 1, of.controller == NULL ? 0 : of.controller->states).at;
    y = filled_numbers(&from, "y", 2, ANY);
    of.y = y.at, of.runs = y.shape[0], of.samples = y.shape[1];
    of.u = filled_of(&from, "u", y.size);
    read_loop_signals(signals, &of);
    require(of.controller != NULL && of.controller->outputs == 1, PyExc_TypeError, "the controller must have one output");
    if (!PyErr_Occurred()) {
        const int scratch = fieldmap_loop_scratch(&of.plant, of.controller);
        work = (double *)memory_of(&from, (size_t)(of.plant.states + of.controller->states + scratch) * sizeof(double));
    }
    if (work != NULL) {
        Py_BEGIN_ALLOW_THREADS
        for (run = 0; run < of.runs; run++) run_loop(&of, run, work);
        Py_END_ALLOW_THREADS
    }
    return nothing(&from);
}

#define SAMPLED_LOOP_FUNCTIONS FUNCTION(sampled_loop)

#endif
