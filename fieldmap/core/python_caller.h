/* python_caller.h: callers that hold only an address, for Python: see fieldmap.core.caller.
 *
 * Code that numba compiles holds a caller as four words: its address, a mark of this process, the number of currents, and the
 * length of `numbers` in call_wrench. Words of another process, for example from cached code or a pickle, give NaN.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_CALLER_H
#define FIELDMAP_PYTHON_CALLER_H

#include <time.h>

#include "caller.h"
#include "python_body.h"
#include "python_iron.h"
#include "python_map.h"
#include "python_table.h"

enum { CALLER_ADDRESS, CALLER_MARK, CALLER_COILS, CALLER_ROOM, CALLER_WORDS };

static const char *const CALLER = "fieldmap.core.caller";

/* A caller and its words. */
typedef struct held_caller {
    fieldmap_caller caller;
    int64_t words[CALLER_WORDS];
} held_caller;

/* Mark of this process. */
static int64_t caller_mark = 0;

static void mark_process(void)
{
    caller_mark = (int64_t)time(NULL) * 1000003 ^ (int64_t)clock() * 8191 ^ (int64_t)(uintptr_t)&caller_mark;
}

static const fieldmap_caller *caller_of(const int64_t *words)
{
    return words[CALLER_MARK] == caller_mark ? (const fieldmap_caller *)(uintptr_t)words[CALLER_ADDRESS] : NULL;
}

/* Room for field and gradient of the last call in this thread; an allocation in every call would add a third to its time. The
 * function is never inlined: on processors with AVX-512 clang 20 keeps numbers in vector registers while it looks up the
 * address of a thread-local variable, although the first look-up in a thread may overwrite these registers. */
__attribute__((noinline)) static double *room_of_thread(void)
{
    static __thread double twelve[12];
    return twelve;
}

/* The twelve numbers of field and gradient at a point for currents, valid until the next call in this thread. */
static double *call_field_of(const int64_t *words, const double *currents, double x, double y, double z)
{
    const fieldmap_caller *of = caller_of(words);
    const double point[3] = {x, y, z};
    double *twelve = room_of_thread();
    if (of == NULL) fieldmap_unknown(twelve, 12);
    else fieldmap_caller_field(of, currents, point, twelve, twelve + 3);
    return twelve;
}

/* The same for a map at fixed currents. All calls in it are inlined, for loops that do little else. */
__attribute__((flatten)) static double *call_field(const int64_t *words, double x, double y, double z)
{
    const fieldmap_caller *of = caller_of(words);
    const double point[3] = {x, y, z};
    double *twelve = room_of_thread();
    if (of == NULL || fieldmap_sets(of->map) != 1) fieldmap_unknown(twelve, 12);
    else fieldmap_field_of_weights(of->map, NULL, point, twelve, twelve + 3);
    return twelve;
}

/* Returns the status of a wrench. numbers: currents, place and rotation, then room for wrench, slopes and work space. */
static int call_wrench(const int64_t *words, double *numbers)
{
    const fieldmap_caller *of = caller_of(words);
    const int64_t coils = words[CALLER_COILS];
    double *place = numbers + coils, *r = place + 3, *wrench = r + 9, *slopes = wrench + 6, *room = slopes + 6 * coils;
    if (of != NULL) return fieldmap_caller_wrench(of, numbers, place, r, room, wrench, slopes);
    fieldmap_unknown(wrench, 6 + 6 * (int)coils);
    return FIELDMAP_ARGUMENT;
}

/* Returns the status of linkages. numbers: currents, place and rotation, then room for linkages, inductances and work space. */
static int call_linkages(const int64_t *words, double *numbers)
{
    const fieldmap_caller *of = caller_of(words);
    const int64_t n = words[CALLER_COILS];
    double *place = numbers + n, *r = place + 3, *linkages = r + 9, *inductance = linkages + n, *room = inductance + n * n;
    if (of != NULL) return fieldmap_caller_linkages(of, numbers, place, r, room, linkages, inductance);
    fieldmap_unknown(linkages, (int)(n + n * n));
    return FIELDMAP_ARGUMENT;
}

/* The linkages of a caller: None, or an object with inductance (n, n) and constant (n,). */
static void read_linkage(reader *from, fieldmap_caller *of)
{
    const int n = fieldmap_caller_coils(of);
    PyObject *given = value_of(from, "linkage");
    reader part = attributes_of(from, given);
    if (given == NULL || given == Py_None) return;
    of->linkage.inductance = numbers_of(&part, "inductance", 2, n * n).at;
    of->linkage.constant = numbers_of(&part, "constant", 1, n).at;
    of->linkage.coils = n;
}

static void read_caller(reader *from, void *out)
{
    held_caller *whole = (held_caller *)out;
    fieldmap_caller *of = &whole->caller;
    PyObject *weights;
    of->map = (const fieldmap *)held_of(from, "map", MAP);
    weights = value_of(from, "weights");
    of->body = (const fieldmap_magnetic_body *)held_or_none(from, "body", BODY);
    if (PyErr_Occurred()) return;
    if (PyCapsule_IsValid(weights, STATE)) of->iron = (fieldmap_iron_state *)PyCapsule_GetPointer(weights, STATE);
    else if (weights != Py_None) of->table = (const fieldmap_current_table *)PyCapsule_GetPointer(weights, TABLE);
    require((of->iron == NULL || of->iron->map->n_fields == fieldmap_sets(of->map))
                && (of->table == NULL
                    || (of->table->fields <= FIELDMAP_CALLER_FIELDS && of->table->fields + 6 == fieldmap_sets(of->map))),
            PyExc_ValueError, "the map must have a field for each weight");
    if (PyErr_Occurred()) return;
    read_linkage(from, of);
    if (PyErr_Occurred()) return;
    whole->words[CALLER_ADDRESS] = (int64_t)(uintptr_t)of;
    whole->words[CALLER_MARK] = caller_mark;
    whole->words[CALLER_COILS] = fieldmap_caller_coils(of);
    whole->words[CALLER_ROOM] =
        18 + (7 + whole->words[CALLER_COILS]) * whole->words[CALLER_COILS] + (int64_t)fieldmap_caller_room(of);
}

/* caller(map, iron state or table or None, body or None, linkage or None): words (4,), an array that keeps the arguments
 * alive. */
static PyObject *caller(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    const npy_intp count = CALLER_WORDS;
    reader from = kept_arguments(args, given, 4);
    PyObject *array, *capsule = held(&from, CALLER, sizeof(held_caller), read_caller);
    (void)self;
    if (capsule == NULL) return NULL;
    array = PyArray_SimpleNewFromData(
        1, &count, NPY_INT64, ((held_caller *)PyCapsule_GetPointer(capsule, CALLER))->words);
    /* PyArray_SetBaseObject takes over the capsule, even if it fails. */
    if (array == NULL || PyArray_SetBaseObject((PyArrayObject *)array, capsule) != 0) {
        if (array == NULL) Py_DECREF(capsule);
        Py_XDECREF(array);
        return NULL;
    }
    PyArray_CLEARFLAGS((PyArrayObject *)array, NPY_ARRAY_WRITEABLE);
    return array;
}

/* caller_functions(): the addresses of the functions above, by name. */
static PyObject *caller_functions(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    (void)self;
    arguments(args, given, 0);
    if (PyErr_Occurred()) return NULL;
    return Py_BuildValue("{s:K,s:K,s:K,s:K}", "call_field", (unsigned long long)(uintptr_t)call_field, "call_field_of",
                         (unsigned long long)(uintptr_t)call_field_of, "call_wrench",
                         (unsigned long long)(uintptr_t)call_wrench, "call_linkages",
                         (unsigned long long)(uintptr_t)call_linkages);
}

#define CALLER_FUNCTIONS FUNCTION(caller), FUNCTION(caller_functions)
#define CALLER_CONSTANTS {"CALLER_COILS", CALLER_COILS}, {"CALLER_ROOM", CALLER_ROOM}

#endif
