/* A map as a block of Simulink: a level-2 S-function in C over fieldmap.h.
 *
 *     fieldmap export linear.h5 --to c -o linear.fmap            (writes fieldmap.h beside it)
 *     mex sfun_fieldmap.c                                        (in MATLAB, in that folder)
 *
 * Block "S-Function", name sfun_fieldmap, parameters: 'linear.fmap', [0 0 0.8]  (the moment, A m^2, frame of the map).
 * Inputs: position (3), m; currents, A. Outputs: flux density (3), T; gradient (9), T/m, dB_i/dx_j at 3 i + j; force and
 * torque (6), N and N m. Outside the map the simulation stops with an error. No state, direct feedthrough.
 *
 * This file was compiled and called through stand-ins for the few functions of simstruc.h that it uses
 * (tests/interop/test_host_examples.py). It was never run in Simulink.
 */
#define S_FUNCTION_NAME sfun_fieldmap
#define S_FUNCTION_LEVEL 2

#include "fieldmap.h"
#include "simstruc.h"

#define FILE_PARAMETER 0
#define MOMENT_PARAMETER 1
#define LONGEST_PATH 1024

/* The map, opened; NULL after an error has been said. */
static fieldmap *open_parameter(SimStruct *S)
{
    char path[LONGEST_PATH];
    fieldmap *map = (fieldmap *)calloc(1, sizeof(fieldmap));
    int status = FIELDMAP_NO_MEMORY;
    if (map != NULL && mxGetString(ssGetSFcnParam(S, FILE_PARAMETER), path, LONGEST_PATH) == 0)
        status = fieldmap_open(map, path);
    if (status != FIELDMAP_OK) {
        ssSetErrorStatus(S, fieldmap_message(status));
        free(map);
        return NULL;
    }
    return map;
}

static void mdlInitializeSizes(SimStruct *S)
{
    fieldmap *map;
    int coils;
    ssSetNumSFcnParams(S, 2);
    if (ssGetNumSFcnParams(S) != ssGetSFcnParamsCount(S)) return;
    if (mxGetNumberOfElements(ssGetSFcnParam(S, MOMENT_PARAMETER)) != 3) {
        ssSetErrorStatus(S, "second parameter: the moment, three numbers in A m^2");
        return;
    }
    /* Opened here to learn how many coils there are. */
    map = open_parameter(S);
    if (map == NULL) return;
    coils = map->n_coils;
    fieldmap_close(map);
    free(map);
    if (!ssSetNumInputPorts(S, 2) || !ssSetNumOutputPorts(S, 3)) return;
    ssSetInputPortWidth(S, 0, 3);
    ssSetInputPortWidth(S, 1, coils);
    ssSetInputPortDirectFeedThrough(S, 0, 1);
    ssSetInputPortDirectFeedThrough(S, 1, 1);
    ssSetInputPortRequiredContiguous(S, 0, 1);
    ssSetInputPortRequiredContiguous(S, 1, 1);
    ssSetOutputPortWidth(S, 0, 3);
    ssSetOutputPortWidth(S, 1, 9);
    ssSetOutputPortWidth(S, 2, 6);
    ssSetNumPWork(S, 1);
    ssSetNumSampleTimes(S, 1);
}

static void mdlInitializeSampleTimes(SimStruct *S)
{
    ssSetSampleTime(S, 0, INHERITED_SAMPLE_TIME);
    ssSetOffsetTime(S, 0, 0.0);
}

#define MDL_START
static void mdlStart(SimStruct *S)
{
    ssSetPWorkValue(S, 0, open_parameter(S));
}

static void mdlOutputs(SimStruct *S, int_T tid)
{
    const fieldmap *map = (const fieldmap *)ssGetPWorkValue(S, 0);
    const double *position = (const double *)ssGetInputPortSignal(S, 0);
    const double *currents = (const double *)ssGetInputPortSignal(S, 1);
    const double *moment = mxGetPr(ssGetSFcnParam(S, MOMENT_PARAMETER));
    double *flux = (double *)ssGetOutputPortSignal(S, 0);
    double *gradient = (double *)ssGetOutputPortSignal(S, 1);
    double *wrench = (double *)ssGetOutputPortSignal(S, 2);
    int status = fieldmap_field(map, currents, position, flux, gradient);
    (void)tid;
    if (status == FIELDMAP_OK) status = fieldmap_wrench(map, currents, position, moment, wrench);
    if (status != FIELDMAP_OK) ssSetErrorStatus(S, fieldmap_message(status));
}

static void mdlTerminate(SimStruct *S)
{
    fieldmap *map = (fieldmap *)ssGetPWorkValue(S, 0);
    fieldmap_close(map);
    free(map);
    ssSetPWorkValue(S, 0, NULL);
}

#ifdef MATLAB_MEX_FILE
#include "simulink.c"
#else
#include "cg_sfun.h"
#endif
