/* Stand-ins for the names of Simulink's simstruc.h that docs/examples/sfun_fieldmap.c uses, so that its functions can be
 * compiled and called without Simulink. Ours, not MathWorks's; they show nothing about Simulink itself. */
#ifndef SIMSTRUC_H
#define SIMSTRUC_H

#include <stddef.h>
#include <string.h>

typedef int int_T;
typedef struct { const char *text; double numbers[16]; size_t count; } mxArray;
typedef struct {
    const mxArray *parameters[2];
    int expected, inputs, outputs, input_width[2], output_width[3], sample_times;
    double *input[2], *output[3];
    void *work;
    const char *error;
} SimStruct;

#define INHERITED_SAMPLE_TIME -1.0
#define ssSetNumSFcnParams(S, n) ((S)->expected = (n))
#define ssGetNumSFcnParams(S) ((S)->expected)
#define ssGetSFcnParamsCount(S) 2
#define ssGetSFcnParam(S, k) ((S)->parameters[k])
#define ssSetErrorStatus(S, text) ((S)->error = (text))
#define ssSetNumInputPorts(S, n) ((S)->inputs = (n), 1)
#define ssSetNumOutputPorts(S, n) ((S)->outputs = (n), 1)
#define ssSetInputPortWidth(S, k, n) ((S)->input_width[k] = (n))
#define ssSetOutputPortWidth(S, k, n) ((S)->output_width[k] = (n))
#define ssSetInputPortDirectFeedThrough(S, k, yes) ((void)(yes))
#define ssSetInputPortRequiredContiguous(S, k, yes) ((void)(yes))
#define ssSetNumPWork(S, n) ((void)(n))
#define ssSetNumSampleTimes(S, n) ((S)->sample_times = (n))
#define ssSetSampleTime(S, k, t) ((void)(S), (void)(t))
#define ssSetOffsetTime(S, k, t) ((void)(S), (void)(t))
#define ssSetPWorkValue(S, k, p) ((S)->work = (p))
#define ssGetPWorkValue(S, k) ((S)->work)
#define ssGetInputPortSignal(S, k) ((S)->input[k])
#define ssGetOutputPortSignal(S, k) ((S)->output[k])
#define mxGetNumberOfElements(a) ((a)->count)
#define mxGetPr(a) ((a)->numbers)

static int mxGetString(const mxArray *a, char *out, size_t size)
{
    if (a->text == NULL || strlen(a->text) >= size) return 1;
    strcpy(out, a->text);
    return 0;
}
#endif
