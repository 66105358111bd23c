/* pyconfig.h: what Python's headers ask about 64-bit Windows, as far as the stable interface needs it.
 *
 * All headers of Python are the same on every system but this one, and Python's own comes with Python for Windows alone.
 * scripts/dev/wheels.py puts this one in its place.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef Py_CONFIG_H
#define Py_CONFIG_H

#define MS_WIN32
#define MS_WIN64
#define MS_WINDOWS

/* Python is a library that is loaded; its names are imported from it. */
#define Py_ENABLE_SHARED 1
#define HAVE_DECLSPEC_DLL

#define SIZEOF_SHORT 2
#define SIZEOF_INT 4
#define SIZEOF_LONG 4
#define SIZEOF_LONG_LONG 8
#define SIZEOF_FLOAT 4
#define SIZEOF_DOUBLE 8
#define SIZEOF_VOID_P 8
#define SIZEOF_SIZE_T 8
#define SIZEOF_TIME_T 8
#define SIZEOF_WCHAR_T 2
#define SIZEOF_PID_T 4

#endif
