/* Co-simulation unit of FMI 2.0: the functions that a simulation calls. */
#include "tanks.h"
#define EXPORT __attribute__((visibility("default")))
typedef void *Component;
typedef unsigned int Ref;

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT Component fmi2Instantiate(const char *name, int kind, const char *guid, const char *resources,
                                 const void *callbacks, int visible, int logging) {
    return create();
}
EXPORT void fmi2FreeInstance(Component c) { free(c); }
EXPORT int fmi2SetupExperiment(Component c, int has_tolerance, double tolerance, double start, int has_stop,
                               double stop) {
    return 0;
}
EXPORT int fmi2EnterInitializationMode(Component c) {
    Tanks *m = c;
    m->v[LEVEL] = m->v[H2];
    return 0;
}
EXPORT int fmi2ExitInitializationMode(Component c) { return 0; }
EXPORT int fmi2Terminate(Component c) { return 0; }
EXPORT int fmi2SetReal(Component c, const Ref *r, size_t n, const double *value) {
    Tanks *m = c;
    for (size_t i = 0; i < n; i++) m->v[r[i]] = value[i];
    return 0;
}
EXPORT int fmi2GetReal(Component c, const Ref *r, size_t n, double *value) {
    Tanks *m = c;
    for (size_t i = 0; i < n; i++) value[i] = value_of(m, r[i]);
    return 0;
}
EXPORT int fmi2DoStep(Component c, double t, double h, int no_set) { return communicate(c, t, h) ? 0 : 3; }
