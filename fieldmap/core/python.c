/* python.c: the run time as a module of Python, fieldmap.core.library.
 *
 * Arrays are float64, in C order and aligned; any other array, and wrong sizes, raise TypeError. Functions of a single point
 * return None instead, also for points outside; their callers then call a function that explains the error. Functions of many
 * points release the interpreter's lock.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#include "python_body.h"
#include "python_caller.h"
#include "python_closed_loop.h"
#include "python_controller.h"
#include "python_field_sensors.h"
#include "python_instruments.h"
#include "python_iron.h"
#include "python_least_power.h"
#include "python_machine.h"
#include "python_map.h"
#include "python_mujoco.h"
#include "python_sampled_loop.h"
#include "python_several_bodies.h"
#include "python_table.h"
#if defined(__x86_64__) && defined(__GNUC__)
#include <cpuid.h>
#endif

/* level(): the highest level of x86-64 that the processor and the system support: 4 with AVX-512, 3 with AVX2 and FMA, else 2.
 * The bits are those of CPUID and XCR0 in Intel's manual, because zig lacks __builtin_cpu_supports. */
static PyObject *level(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    long found = 2;
    (void)self, (void)args, (void)given;
#if defined(__x86_64__) && defined(__GNUC__)
    {
        /* Bits of FMA, OSXSAVE and AVX; of AVX2, BMI1 and BMI2; of AVX-512 F, DQ, CD, BW and VL. */
        const unsigned first = 1u << 12 | 1u << 27 | 1u << 28, second = 1u << 3 | 1u << 5 | 1u << 8;
        const unsigned third = 1u << 16 | 1u << 17 | 1u << 28 | 1u << 30 | 1u << 31;
        unsigned a, b, c, d, saved = 0;
        if (__get_cpuid(1, &a, &b, &c, &d) && (c & first) == first && __get_cpuid_count(7, 0, &a, &b, &c, &d)
            && (b & second) == second) {
            /* The system saves registers of 256 bits (0x06), and of 512 bits (0xe6). */
            __asm__("xgetbv" : "=a"(saved) : "c"(0) : "edx");
            if ((saved & 0x06u) == 0x06u) found = 3;
            if (found == 3 && (b & third) == third && (saved & 0xe6u) == 0xe6u) found = 4;
        }
    }
#endif
    return PyLong_FromLong(found);
}

#define FUNCTION(name) {#name, (PyCFunction)(void (*)(void))name, METH_FASTCALL, NULL}

static PyMethodDef functions[] = {
    FUNCTION(level), MAP_FUNCTIONS, BODY_FUNCTIONS, CALLER_FUNCTIONS, CLOSED_LOOP_FUNCTIONS, CONTROLLER_FUNCTIONS, FIELD_SENSOR_FUNCTIONS,
    INSTRUMENT_FUNCTIONS,
    IRON_FUNCTIONS, LEAST_POWER_FUNCTIONS, MACHINE_FUNCTIONS, MUJOCO_FUNCTIONS, SAMPLED_LOOP_FUNCTIONS, SEVERAL_BODIES_FUNCTIONS, TABLE_FUNCTIONS,
    {NULL, NULL, 0, NULL}};

#define CONSTANT(name) {#name, FIELDMAP_##name}

/* Names and values of the core's enumerations. */
static const struct {
    const char *name;
    long value;
} constants[] = {MAP_CONSTANTS, CALLER_CONSTANTS, CLOSED_LOOP_CONSTANTS, CONTROLLER_CONSTANTS, IRON_CONSTANTS, LEAST_POWER_CONSTANTS,
               MACHINE_CONSTANTS, SEVERAL_BODIES_CONSTANTS, TABLE_CONSTANTS};

static int start(PyObject *module)
{
    PyObject *edge;
    size_t k;
    int failed;
    mark_process();
    for (k = 0; k < sizeof constants / sizeof *constants; k++)
        if (PyModule_AddIntConstant(module, constants[k].name, constants[k].value) != 0) return -1;
    edge = PyFloat_FromDouble(FIELDMAP_EDGE);
    failed = PyModule_AddObjectRef(module, "EDGE", edge);
    Py_XDECREF(edge);
    if (failed) return -1;
    return PyArray_ImportNumPyAPI();
}

static PyModuleDef_Slot slots[] = {{Py_mod_exec, (void *)start}, {0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "library", "The compiled run time.", 0, functions, slots, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit_library(void)
{
    return PyModuleDef_Init(&definition);
}
