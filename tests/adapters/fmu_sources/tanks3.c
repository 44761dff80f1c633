/* Co-simulation unit of FMI 3.0: the functions that a simulation calls. */
#include <stdbool.h>
#include <stdint.h>
#include "tanks.h"
#define EXPORT __attribute__((visibility("default")))
typedef void *Instance;
typedef uint32_t Ref;

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
EXPORT Instance fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                            bool logging, bool event_mode, bool early_return, const Ref *required,
                                            size_t n, void *environment, void *log, void *update) {
    return create();
}
EXPORT void fmi3FreeInstance(Instance c) { free(c); }
EXPORT int fmi3EnterInitializationMode(Instance c, bool has_tolerance, double tolerance, double start, bool has_stop,
                                       double stop) {
    Tanks *m = c;
    m->v[LEVEL] = m->v[H2];
    return 0;
}
EXPORT int fmi3ExitInitializationMode(Instance c) { return 0; }
EXPORT int fmi3Terminate(Instance c) { return 0; }
EXPORT int fmi3SetFloat64(Instance c, const Ref *r, size_t n, const double *value, size_t n_values) {
    Tanks *m = c;
    for (size_t i = 0; i < n; i++) m->v[r[i]] = value[i];
    return 0;
}
EXPORT int fmi3GetFloat64(Instance c, const Ref *r, size_t n, double *value, size_t n_values) {
    Tanks *m = c;
    for (size_t i = 0; i < n; i++) value[i] = value_of(m, r[i]);
    return 0;
}
EXPORT int fmi3DoStep(Instance c, double t, double h, bool no_set, bool *event, bool *terminate, bool *early,
                      double *last) {
    Tanks *m = c;
    *event = *early = false;
    /* More than 1000 ml/s end the simulation. */
    *terminate = m->v[PUMP] > 1000.0;
    int good = communicate(m, t, h);
    *last = m->time;
    return good ? 0 : 3;
}
