/* One step of a controller at 1 kHz on a map of saturating iron, timed a million times; see loop_1khz.py.
 *
 *     loop_1khz MAP.fmap STEPS PACED_SECONDS THREADS DERIVATIVES REALTIME
 *
 * A step: new currents, their weights by the model of the iron (with derivatives by the currents if asked for), field,
 * gradient and wrench on a dipole at a place that moves. Every thousandth step the currents leap to the other end of the
 * domain. Nothing takes memory. Prints figures in us.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>

#include "fieldmap_iron.h"

enum { LEAP = 1000, MOST = 64, LOAD = 32 << 20 };

static atomic_int stop;
static volatile double sink;

static double now(clockid_t clock)
{
    struct timespec t;
    clock_gettime(clock, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

/* A thread of load: every second one computes, the others move memory through the caches. */
static void *busy(void *which)
{
    unsigned char *memory = which == NULL ? malloc(2 * (size_t)LOAD) : NULL;
    double x = 1.0;
    while (!atomic_load(&stop)) {
        if (memory != NULL) {
            memcpy(memory, memory + LOAD, LOAD);
            memory[LOAD] += memory[0];
        }
        else
            for (int k = 0; k < 1000000; k++) x += 1.0 / x;
        sink = x;
    }
    free(memory);
    return NULL;
}

/* The currents of a step: a slow path through the domain, the noise of a controller on it, and leaps. */
static void ask(const fieldmap_iron *map, long step, uint64_t *seed, double *signals, double *currents)
{
    const double t = 1e-3 * (double)step;
    const int leap = step % LEAP == LEAP - 1;
    for (int j = 0; j < map->n_signals; j++) {
        double share = 0.5 + 0.4 * sin((0.5 + 0.37 * j) * t + 1.3 * j);
        *seed = *seed * 6364136223846793005u + 1442695040888963407u;
        share += 1e-3 * ((double)(*seed >> 11) / 9007199254740992.0 - 0.5);
        if (leap) share = 1.0 - share;
        signals[j] = map->lower[j] + share * (map->upper[j] - map->lower[j]);
    }
    if (map->division) fieldmap_divide(signals[0], signals[1], signals[2], map->exponent, currents);
    else
        for (int k = 0; k < map->n_coils; k++) {
            currents[k] = 0.0;
            for (int j = 0; j < map->n_signals; j++) currents[k] += map->matrix[k * map->n_signals + j] * signals[j];
        }
}

static int smaller(const void *a, const void *b)
{
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static void say(const char *what, float *values, long count)
{
    qsort(values, (size_t)count, sizeof *values, smaller);
    printf("%s median %.1f, 99.9 %% %.1f, 99.999 %% %.1f, worst %.1f us\n", what, (double)values[count / 2],
        (double)values[(long)(0.999 * (double)(count - 1))], (double)values[(long)(0.99999 * (double)(count - 1))],
        (double)values[count - 1]);
}

int main(int argc, char **argv)
{
    static unsigned char memory[64 << 20] __attribute__((aligned(64)));
    static double weights[4096], slopes[4096 * MOST];
    fieldmap_iron map;
    fieldmap_iron_state state;
    pthread_t threads[16];
    double signals[MOST], currents[MOST], flux[3], gradient[9], wrench[6], point[3];
    const double moment[3] = {0.0, 0.0, 0.8};
    uint64_t seed = 1;
    int status, bad = 0;
    if (argc != 7) return 2;
    const long steps = atol(argv[2]), paced = 1000 * atol(argv[3]);
    const int load = atoi(argv[4]), derivatives = atoi(argv[5]), realtime = atoi(argv[6]);
    status = fieldmap_iron_open(&map, argv[1]);
    if (status == FIELDMAP_OK) status = fieldmap_iron_start(&state, &map, memory, sizeof memory);
    if (status != FIELDMAP_OK || map.n_coils > MOST || map.n_fields > 4096 || load > 16) {
        fprintf(stderr, "%s: %s\n", argv[1], fieldmap_iron_message(status));
        return 1;
    }
    float *wall = malloc((size_t)(steps + paced) * sizeof *wall), *own = malloc((size_t)(steps + paced) * sizeof *own);
    float *late = malloc((size_t)(paced + 1) * sizeof *late);
    if (wall == NULL || own == NULL || late == NULL) return 1;
    memset(wall, 0, (size_t)(steps + paced) * sizeof *wall), memset(own, 0, (size_t)(steps + paced) * sizeof *own);
    memset(late, 0, (size_t)(paced + 1) * sizeof *late);
    for (int k = 0; k < load; k++) pthread_create(&threads[k], NULL, busy, k % 2 ? &stop : NULL);
    for (int part = 0; part < 2; part++) {
        if (part && realtime) {
            const struct sched_param highest = {.sched_priority = 80};
            const int refused = pthread_setschedparam(pthread_self(), SCHED_FIFO, &highest);
            const int loose = mlockall(MCL_CURRENT | MCL_FUTURE);
            printf("real-time priority %s, memory %s\n", refused ? strerror(refused) : "80", loose ? "not locked" : "locked");
        }
        const long count = part ? paced : steps;
        struct timespec next;
        float *of_wall = wall + (part ? steps : 0), *of_own = own + (part ? steps : 0);
        clock_gettime(CLOCK_MONOTONIC, &next);
        for (long step = 0; step < count; step++) {
            if (part) {
                next.tv_nsec += 1000000;
                if (next.tv_nsec >= 1000000000) next.tv_nsec -= 1000000000, next.tv_sec++;
                while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, NULL) == EINTR) { }
                late[step] = (float)(now(CLOCK_MONOTONIC) - 1e6 * (double)next.tv_sec - 1e-3 * (double)next.tv_nsec);
            }
            ask(&map, step, &seed, signals, currents);
            for (int k = 0; k < 3; k++)
                point[k] = map.fields.lower[k]
                    + (0.5 + 0.4 * sin(1e-3 * (double)step * (1.0 + k))) * (map.fields.upper[k] - map.fields.lower[k]);
            const double begin = now(CLOCK_MONOTONIC), begun = now(CLOCK_THREAD_CPUTIME_ID);
            status = derivatives ? fieldmap_iron_slopes(&state, currents, weights, slopes) : FIELDMAP_OK;
            if (status == FIELDMAP_OK) status = fieldmap_iron_field(&state, currents, point, flux, gradient);
            if (status == FIELDMAP_OK) status = fieldmap_iron_wrench(&state, currents, point, moment, wrench);
            of_own[step] = (float)(now(CLOCK_THREAD_CPUTIME_ID) - begun);
            of_wall[step] = (float)(now(CLOCK_MONOTONIC) - begin);
            bad += status != FIELDMAP_OK;
            sink = wrench[0];
        }
        if (!count) continue;
        printf("%ld steps %s, %d failed\n", count, part ? "a millisecond apart" : "one after the other", bad);
        if (part) say("  woken late by      ", late, count);
        say("  a step, by the clock ", of_wall, count);
        say("  its processor time   ", of_own, count);
        fflush(stdout);
    }
    atomic_store(&stop, 1);
    for (int k = 0; k < load; k++) pthread_join(threads[k], NULL);
    fieldmap_iron_close(&map);
    free(wall), free(own), free(late);
    return bad != 0;
}
