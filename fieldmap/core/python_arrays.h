/* python_arrays.h: arguments of the functions that Python calls.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_PYTHON_ARRAYS_H
#define FIELDMAP_PYTHON_ARRAYS_H

#include <stdio.h>
#include <string.h>

#define Py_LIMITED_API 0x030B0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#define NPY_TARGET_VERSION NPY_2_0_API_VERSION
#include <numpy/arrayobject.h>

/* The numbers of an array with `count` of them and this many dimensions, or NULL. */
static double *numbers_of(PyObject *given, int dimensions, npy_intp count)
{
    PyArrayObject *array = (PyArrayObject *)given;
    if (!PyArray_Check(given) || PyArray_NDIM(array) != dimensions || PyArray_TYPE(array) != NPY_DOUBLE) return NULL;
    if (!PyArray_IS_C_CONTIGUOUS(array) || !PyArray_ISBEHAVED_RO(array)) return NULL;
    return PyArray_SIZE(array) == count ? (double *)PyArray_DATA(array) : NULL;
}

/* The same for numbers to fill; raises TypeError. */
static double *numbers_to_fill(PyObject *given, npy_intp count, const char *name)
{
    PyArrayObject *array = (PyArrayObject *)given;
    if (PyArray_Check(given) && PyArray_TYPE(array) == NPY_DOUBLE && PyArray_ISCARRAY(array)
        && PyArray_SIZE(array) == count)
        return (double *)PyArray_DATA(array);
    PyErr_Format(PyExc_TypeError, "%s must be a writeable float64 array in C order of %zd numbers", name, (Py_ssize_t)count);
    return NULL;
}

/* The numbers of a vector, and how many; raises TypeError. */
static double *vector_of(PyObject *given, npy_intp *count, const char *name)
{
    double *numbers = NULL;
    *count = PyArray_Check(given) ? PyArray_SIZE((PyArrayObject *)given) : 0;
    if (*count > 0) numbers = numbers_of(given, 1, *count);
    if (numbers == NULL) PyErr_Format(PyExc_TypeError, "%s must be a float64 vector in C order", name);
    return numbers;
}

/* The numbers of an array (n, 3), or NULL, and n. */
static const double *points_of(PyObject *given, npy_intp *count)
{
    PyArrayObject *array = (PyArrayObject *)given;
    *count = 0;
    if (!PyArray_Check(given) || PyArray_NDIM(array) != 2 || PyArray_DIM(array, 1) != 3) return NULL;
    *count = PyArray_DIM(array, 0);
    return numbers_of(given, 2, 3 * *count);
}

/* Whether as many arguments were given as are wanted; raises TypeError. */
static int has_arguments(Py_ssize_t given, Py_ssize_t wanted)
{
    if (given == wanted) return 1;
    PyErr_Format(PyExc_TypeError, "%zd arguments are needed, %zd were given", wanted, given);
    return 0;
}

/* Attributes of an object of Python. Those that are missing or of another kind raise an error, and the answer is 0 or NULL. */

static int real_attribute(PyObject *of, const char *name, double *out)
{
    PyObject *given = PyObject_GetAttrString(of, name);
    if (given == NULL) return 0;
    *out = PyFloat_AsDouble(given);
    Py_DECREF(given);
    return !PyErr_Occurred();
}

static int whole_attribute(PyObject *of, const char *name, long *out)
{
    PyObject *given = PyObject_GetAttrString(of, name);
    if (given == NULL) return 0;
    *out = PyLong_AsLong(given);
    Py_DECREF(given);
    return !PyErr_Occurred();
}

/* An array of float64 in C order with this many dimensions: a new reference. */
static PyArrayObject *array_attribute(PyObject *of, const char *name, int dimensions)
{
    PyObject *given = PyObject_GetAttrString(of, name);
    if (given == NULL) return NULL;
    if (PyArray_Check(given) && numbers_of(given, dimensions, PyArray_SIZE((PyArrayObject *)given)) != NULL)
        return (PyArrayObject *)given;
    PyErr_Format(PyExc_TypeError, "%s must be a float64 array of %d dimensions in C order", name, dimensions);
    Py_DECREF(given);
    return NULL;
}

/* Copy the `count` numbers of an array of one or two dimensions. */
static int numbers_attribute(PyObject *of, const char *name, int dimensions, npy_intp count, double *out)
{
    PyArrayObject *array = array_attribute(of, name, dimensions);
    int fits;
    if (array == NULL) return 0;
    fits = PyArray_SIZE(array) == count;
    if (fits) memcpy(out, PyArray_DATA(array), (size_t)count * sizeof(double));
    else PyErr_Format(PyExc_TypeError, "%s must hold %zd numbers", name, (Py_ssize_t)count);
    Py_DECREF((PyObject *)array);
    return fits;
}

/* The numbers of an attribute of `count` numbers, any count where it is negative, which the list `kept` keeps alive; NULL and
 * an error where it does not fit. */
static double *kept_attribute(PyObject *of, const char *name, int dimensions, npy_intp count, PyObject *kept)
{
    PyArrayObject *array = array_attribute(of, name, dimensions);
    double *numbers = NULL;
    if (array == NULL) return NULL;
    if (count >= 0 && PyArray_SIZE(array) != count)
        PyErr_Format(PyExc_TypeError, "%s must hold %zd numbers", name, (Py_ssize_t)count);
    else if (PyList_Append(kept, (PyObject *)array) == 0)
        numbers = (double *)PyArray_DATA(array);
    Py_DECREF((PyObject *)array);
    return numbers;
}

/* The same of an array to which is written. */
static double *filled_attribute(PyObject *of, const char *name, int dimensions, npy_intp count, PyObject *kept)
{
    double *numbers = kept_attribute(of, name, dimensions, count, kept);
    PyObject *array = numbers == NULL ? NULL : PyList_GetItem(kept, PyList_Size(kept) - 1);
    if (array == NULL) return NULL;
    if (PyArray_ISWRITEABLE((PyArrayObject *)array)) return numbers;
    PyErr_Format(PyExc_TypeError, "%s must be writable", name);
    return NULL;
}

/* How many rows an attribute of two dimensions has, or -1 and an error. */
static npy_intp rows_of_attribute(PyObject *of, const char *name)
{
    PyArrayObject *array = array_attribute(of, name, 2);
    npy_intp rows = array == NULL ? -1 : PyArray_DIM(array, 0);
    Py_XDECREF((PyObject *)array);
    return rows;
}

/* What a capsule of this name points to, which `kept` keeps alive; NULL without an error for None. */
static void *capsule_attribute(PyObject *of, const char *name, const char *kind, PyObject *kept)
{
    PyObject *given = PyObject_GetAttrString(of, name);
    void *found = NULL;
    if (given == NULL) return NULL;
    if (given != Py_None && (found = PyCapsule_GetPointer(given, kind)) != NULL && PyList_Append(kept, given) != 0)
        found = NULL;
    Py_DECREF(given);
    return found;
}

#endif
