/* python_reader.h: reading of arguments and returning of results in the functions that Python calls.
 *
 * A reader takes the arguments of a call one after another, or the attributes of an object by their names. Arrays must be
 * float64, in C order and aligned; any other array, and wrong sizes, raise TypeError. After an error each further read returns
 * 0 or NULL and keeps the error: a function reads all its arguments, then checks for an error once.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_READER_H
#define FIELDMAP_PYTHON_READER_H

/* The headers of numpy need stdio.h. */
#include <stdio.h>
#include <string.h>

#define Py_LIMITED_API 0x030B0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#define NPY_TARGET_VERSION NPY_2_0_API_VERSION
#include <numpy/arrayobject.h>

/* object: the object whose attributes are read, or NULL to read the arguments from `next` on. kept: a list of objects that
 * must stay alive while their numbers are used; NULL until it is needed. */
typedef struct reader {
    PyObject *const *next;
    PyObject *object, *kept;
} reader;

/* The numbers of an array, its size and shape. at: NULL after an error, or for None if None is allowed. */
typedef struct number_array {
    double *at;
    npy_intp size, shape[5];
} number_array;

enum { ANY = -1 };

/* A reader of the arguments of a call, which must be `wanted` in number. */
static reader arguments(PyObject *const *args, Py_ssize_t given, Py_ssize_t wanted)
{
    const reader from = {args, NULL, NULL};
    if (given != wanted) PyErr_Format(PyExc_TypeError, "%zd arguments are needed, %zd were given", wanted, given);
    return from;
}

/* Set an error unless the condition holds or an error is set already. */
static void require(int holds, PyObject *kind, const char *message)
{
    if (!holds && !PyErr_Occurred()) PyErr_SetString(kind, message);
}

static int keep(reader *from, PyObject *value)
{
    if (from->kept == NULL) from->kept = PyList_New(0);
    return from->kept != NULL && PyList_Append(from->kept, value) == 0;
}

/* As `arguments`, for a call whose result keeps its arguments alive. */
static reader kept_arguments(PyObject *const *args, Py_ssize_t given, Py_ssize_t wanted)
{
    reader from = arguments(args, given, wanted);
    Py_ssize_t k;
    for (k = 0; k < wanted && !PyErr_Occurred(); k++) keep(&from, args[k]);
    return from;
}

/* The next argument, or the attribute of this name, which the reader keeps alive. The reference is borrowed. */
static PyObject *value_of(reader *from, const char *name)
{
    PyObject *value;
    if (PyErr_Occurred()) return NULL;
    if (from->object == NULL) return *from->next++;
    value = PyObject_GetAttrString(from->object, name);
    if (value == NULL) return NULL;
    if (!keep(from, value)) {
        Py_DECREF(value);
        return NULL;
    }
    Py_DECREF(value);
    return value;
}

/* A reader of an object's attributes (part_of: of an attribute's). `from` keeps the values alive. */
static reader attributes_of(reader *from, PyObject *object)
{
    reader part = {NULL, object, NULL};
    if (object != NULL && from->kept == NULL) from->kept = PyList_New(0);
    part.kept = from->kept;
    return part;
}

static reader part_of(reader *from, const char *name)
{
    return attributes_of(from, value_of(from, name));
}

static double real_of(reader *from, const char *name)
{
    PyObject *value = value_of(from, name);
    return value == NULL ? 0.0 : PyFloat_AsDouble(value);
}

static long whole_of(reader *from, const char *name)
{
    PyObject *value = value_of(from, name);
    return value == NULL ? 0 : PyLong_AsLong(value);
}

static uintptr_t address_of(reader *from, const char *name)
{
    PyObject *value = value_of(from, name);
    return value == NULL ? 0 : (uintptr_t)PyLong_AsUnsignedLongLong(value);
}

static int truth_of(reader *from, const char *name)
{
    PyObject *value = value_of(from, name);
    return value != NULL && PyObject_IsTrue(value) == 1;
}

/* The pointer in a capsule of this kind. */
static void *held_of(reader *from, const char *name, const char *kind)
{
    PyObject *value = value_of(from, name);
    return value == NULL ? NULL : PyCapsule_GetPointer(value, kind);
}

/* The same, and NULL for None. */
static void *held_or_none(reader *from, const char *name, const char *kind)
{
    PyObject *value = value_of(from, name);
    return value == NULL || value == Py_None ? NULL : PyCapsule_GetPointer(value, kind);
}

/* Whether a value is a float64 array in C order with this number of dimensions. */
static int is_array(PyObject *value, int dimensions)
{
    PyArrayObject *array = (PyArrayObject *)value;
    return PyArray_Check(value) && PyArray_NDIM(array) == dimensions && PyArray_TYPE(array) == NPY_DOUBLE
        && PyArray_IS_C_CONTIGUOUS(array) && PyArray_ISBEHAVED_RO(array);
}

static number_array numbers_in(PyObject *value, const char *name, int dimensions, npy_intp size)
{
    number_array found = {NULL, 0, {0}};
    PyArrayObject *array = (PyArrayObject *)value;
    if (value == NULL) return found;
    if (!is_array(value, dimensions)) {
        PyErr_Format(PyExc_TypeError, "%s must be a float64 array of %d dimensions in C order", name, dimensions);
    } else if (size != ANY && PyArray_SIZE(array) != size) {
        PyErr_Format(PyExc_TypeError, "%s must hold %zd numbers, not %zd", name, (Py_ssize_t)size,
                     (Py_ssize_t)PyArray_SIZE(array));
    } else {
        found.at = (double *)PyArray_DATA(array), found.size = PyArray_SIZE(array);
        memcpy(found.shape, PyArray_DIMS(array), (size_t)dimensions * sizeof(npy_intp));
    }
    return found;
}

/* The numbers of an array of at most five dimensions and this size; ANY: any size. */
static number_array numbers_of(reader *from, const char *name, int dimensions, npy_intp size)
{
    return numbers_in(value_of(from, name), name, dimensions, size);
}

/* The same, or None. */
static number_array numbers_or_none(reader *from, const char *name, int dimensions, npy_intp size)
{
    PyObject *value = value_of(from, name);
    return numbers_in(value == Py_None ? NULL : value, name, dimensions, size);
}

/* The numbers of an array (n, 3); n is shape[0]. */
static number_array points_of(reader *from, const char *name)
{
    number_array points = numbers_of(from, name, 2, ANY);
    require(points.shape[1] == 3, PyExc_TypeError, "points must be (n, 3)");
    return points;
}

static void copy_of(reader *from, const char *name, int dimensions, npy_intp size, double *out)
{
    number_array given = numbers_of(from, name, dimensions, size);
    if (given.at != NULL) memcpy(out, given.at, (size_t)size * sizeof(double));
}

/* As `numbers_of`, for an array that C writes to. */
static number_array filled_numbers(reader *from, const char *name, int dimensions, npy_intp size)
{
    PyObject *value = value_of(from, name);
    const number_array found = numbers_in(value, name, dimensions, size);
    require(found.at == NULL || PyArray_ISWRITEABLE((PyArrayObject *)value), PyExc_TypeError, "an array must be writeable");
    return found;
}

/* The data of an array that C writes to: of any shape, with `size` elements of a type. */
static void *data_to_fill(PyObject *value, const char *name, int type, npy_intp size)
{
    PyArrayObject *array = (PyArrayObject *)value;
    if (value == NULL) return NULL;
    if (PyArray_Check(value) && PyArray_TYPE(array) == type && PyArray_ISCARRAY(array) && PyArray_SIZE(array) == size)
        return PyArray_DATA(array);
    PyErr_Format(PyExc_TypeError, "%s must be a writeable array in C order of %zd elements of %s", name, (Py_ssize_t)size,
                 type == NPY_DOUBLE ? "float64" : "int64");
    return NULL;
}

static double *filled_of(reader *from, const char *name, npy_intp size)
{
    return (double *)data_to_fill(value_of(from, name), name, NPY_DOUBLE, size);
}

/* The same, or NULL for None. */
static double *filled_or_none(reader *from, const char *name, npy_intp size)
{
    PyObject *value = value_of(from, name);
    return (double *)data_to_fill(value == Py_None ? NULL : value, name, NPY_DOUBLE, size);
}

static int64_t *filled_whole_of(reader *from, const char *name, npy_intp size)
{
    return (int64_t *)data_to_fill(value_of(from, name), name, NPY_INT64, size);
}

/* Zeroed memory that the reader keeps alive, aligned to a cache line. */
static void *memory_of(reader *from, size_t bytes)
{
    PyObject *array = PyErr_Occurred() ? NULL : PyByteArray_FromStringAndSize(NULL, (Py_ssize_t)(bytes + 64));
    char *begin = array != NULL && keep(from, array) ? PyByteArray_AsString(array) : NULL;
    Py_XDECREF(array);
    if (begin == NULL) return NULL;
    begin += 64 - (uintptr_t)begin % 64;
    return memset(begin, 0, bytes);
}

/* Release the objects that the reader keeps, and return the result, or NULL if there is an error. */
static PyObject *answer(reader *from, PyObject *value)
{
    Py_XDECREF(from->kept);
    if (!PyErr_Occurred()) return value;
    Py_XDECREF(value);
    return NULL;
}

static PyObject *nothing(reader *from)
{
    return answer(from, Py_NewRef(Py_None));
}

/* A new array (rows,) or (rows, columns) for `out` to fill. */
static PyObject *new_array(int dimensions, npy_intp rows, npy_intp columns, double **out)
{
    const npy_intp shape[2] = {rows, columns};
    PyObject *array = PyArray_SimpleNew(dimensions, shape, NPY_DOUBLE);
    *out = array == NULL ? NULL : (double *)PyArray_DATA((PyArrayObject *)array);
    return array;
}

static void release(PyObject *capsule)
{
    PyMem_Free(PyCapsule_GetPointer(capsule, PyCapsule_GetName(capsule)));
    Py_XDECREF((PyObject *)PyCapsule_GetContext(capsule));
}

/* A capsule of a structure that `read` fills. It keeps the objects of the reader alive. NULL if there is an error. */
static PyObject *held(reader *from, const char *kind, size_t size, void (*read)(reader *, void *))
{
    void *structure = PyErr_Occurred() ? NULL : PyMem_Calloc(1, size);
    PyObject *capsule = NULL;
    if (structure != NULL) read(from, structure);
    else if (!PyErr_Occurred()) PyErr_NoMemory();
    if (!PyErr_Occurred()) capsule = PyCapsule_New(structure, kind, release);
    if (capsule != NULL && PyCapsule_SetContext(capsule, from->kept) == 0) return capsule;
    Py_XDECREF(from->kept);
    if (capsule == NULL) PyMem_Free(structure);
    Py_XDECREF(capsule);
    return NULL;
}

#endif
