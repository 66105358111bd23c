/* A magnet held in the air by a loop at 1 kHz: the map in single precision says what force an ampere makes.
 *
 * The magnet here is a simulated one, a point mass that stays upright, in the field of the same map, by ten steps a
 * sample. On a microcontroller a timer calls `control`, which takes no memory and has no loop without a bound.
 *
 *     fieldmap export linear.h5 --to c32 --kind global -o lift.h
 *     gcc -O2 levitate_1khz.c -o levitate && ./levitate          as fast as it goes
 *     ./levitate real                                            one sample a millisecond
 */
#define _POSIX_C_SOURCE 200112L
#include <stdio.h>
#include <time.h>

#include "lift.h"

#define PERIOD 1.0e-3f
#define SAMPLES 10000

static const float mass = 0.01119f;                   /* kg */
static const float moment[3] = {0.0f, 0.0f, 0.8f};    /* A m^2 */
static const float weight = 0.01119f * 9.80665f;      /* N */
static const float target = -0.09f;                   /* m */

typedef struct {
    float integral;
    float before;
} memory;

/* The current, A, of all coils alike, from the place of the magnet that a sensor sees: one sample. */
static float control(memory *state, const float place[3])
{
    const float error = target - place[2];
    const float speed = (place[2] - state->before) / PERIOD;
    float ones[32];
    float wrench[6];
    float wanted;
    float current = 0.0f;
    int32_t k;
    for (k = 0; k < 32; k++) {
        ones[k] = 1.0f;
    }
    state->before = place[2];
    state->integral += error * PERIOD;
    wanted = weight * (1.0f + 60.0f * error - 2.7f * speed + 60.0f * state->integral);
    if ((lift.coils <= 32) && (fm32_wrench(&lift, ones, place, moment, wrench) == FM32_OK) && (wrench[2] > 0.0f)) {
        current = wanted / wrench[2];
    }
    return current;
}

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1.0e-9 * (double)now.tv_nsec;
}

static void wait_until(double time)
{
    struct timespec pause;
    double left = time - seconds();
    if (left > 0.0) {
        pause.tv_sec = (time_t)left;
        pause.tv_nsec = (long)(1.0e9 * (left - (double)pause.tv_sec));
        nanosleep(&pause, NULL);
    }
}

int main(int argc, char **argv)
{
    const int real = argc > 1 && argv[1][0] == 'r';
    const int samples = real ? SAMPLES / 10 : SAMPLES;
    double place[3] = {0.001, -0.0005, -0.091}, speed[3] = {0.0, 0.0, 0.0};
    double spent = 0.0, longest = 0.0, latest = 0.0, worst = 0.0, start = seconds();
    memory state = {0.0f, -0.091f};
    int n, step, i;
    for (n = 0; n < samples; n++) {
        float seen[3], currents[32], current, wrench[6];
        double begin, took;
        if (real) {
            wait_until(start + 1.0e-3 * n);
            if (seconds() - (start + 1.0e-3 * n) > latest) latest = seconds() - (start + 1.0e-3 * n);
        }
        for (i = 0; i < 3; i++) seen[i] = (float)place[i];
        begin = seconds();
        current = control(&state, seen);
        took = seconds() - begin;
        spent += took;
        if (took > longest) longest = took;
        for (i = 0; i < 32; i++) currents[i] = current;
        for (step = 0; step < 10; step++) {
            for (i = 0; i < 3; i++) seen[i] = (float)place[i];
            if (fm32_wrench(&lift, currents, seen, moment, wrench) != FM32_OK) {
                printf("left the map after %d samples\n", n);
                return 1;
            }
            for (i = 0; i < 3; i++) {
                /* A little air damps the sways that no coil can. */
                double force = (double)wrench[i] - 0.05 * speed[i] - (i == 2 ? (double)weight : 0.0);
                speed[i] += 1.0e-4 * force / (double)mass;
                place[i] += 1.0e-4 * speed[i];
            }
        }
        if (n > samples / 2 && (place[2] - (double)target) * (place[2] - (double)target) > worst * worst)
            worst = place[2] > (double)target ? place[2] - (double)target : (double)target - place[2];
    }
    printf("%d samples, at most %.4f mm off in the second half\n", samples, 1.0e3 * worst);
    printf("a call of control: %.2f us in the mean, %.1f us at most\n", 1.0e6 * spent / samples, 1.0e6 * longest);
    if (real) printf("woken up at most %.0f us late\n", 1.0e6 * latest);
    return 0;
}
