/* Two tanks in series by the Runge-Kutta method with substeps of 1 s, in the order of operations of the bench. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { H1, H2, PUMP, A1, A2, GAIN, LEVEL, SECOND, N };
#define S 4e-3
#define G 9.81

/* Length of an internal step [s]; 0: a step of any length. */
#ifndef STEP
#define STEP 0.0
#endif
enum { TIME = 99 };

typedef struct {
    double v[N], time;
} Tanks;

static void slope(const Tanks *m, const double *x, double *dx) {
    double q1 = m->v[A1] * sqrt(2 * G * x[0]), q2 = m->v[A2] * sqrt(2 * G * x[1]);
    dx[0] = (m->v[GAIN] * 1e-6 * m->v[PUMP] - q1) / S;
    dx[1] = (q1 - q2 + 1e-6 * m->v[SECOND]) / S;
}

static int advance(Tanks *m, double length) {
    int n = 5, i, j;
    double h = length / n, k1[2], k2[2], k3[2], k4[2], x[2] = {m->v[H1], m->v[H2]}, z[2];
    for (i = 0; i < n; i++) {
        slope(m, x, k1);
        for (j = 0; j < 2; j++) z[j] = x[j] + h / 2 * k1[j];
        slope(m, z, k2);
        for (j = 0; j < 2; j++) z[j] = x[j] + h / 2 * k2[j];
        slope(m, z, k3);
        for (j = 0; j < 2; j++) z[j] = x[j] + h * k3[j];
        slope(m, z, k4);
        for (j = 0; j < 2; j++) x[j] = x[j] + h / 6 * (k1[j] + 2 * (k2[j] + k3[j]) + k4[j]);
    }
    m->v[H1] = x[0];
    m->v[H2] = m->v[LEVEL] = x[1];
    m->time += length;
    /* A level below zero has no outflow: an error of the FMU. */
    return isfinite(x[0]) && isfinite(x[1]);
}

/* Advance to the end of a communication step, or to the last internal step before it. */
static int communicate(Tanks *m, double t, double h) {
    int good = 1;
    if (STEP == 0.0) return advance(m, h);
    while (good && m->time + STEP <= t + h + 1e-9) good = advance(m, STEP);
    return good;
}

static double value_of(const Tanks *m, unsigned int r) { return r == TIME ? m->time : m->v[r]; }

static Tanks *create(void) {
    Tanks *m = calloc(1, sizeof(Tanks));
    const double start[N] = {0.2, 0.1, 0.0, 7.1e-6, 6.3e-6, 1.0, 0.1};
    memcpy(m->v, start, sizeof(start));
    return m;
}
