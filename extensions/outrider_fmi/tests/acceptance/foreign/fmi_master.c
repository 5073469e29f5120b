/* A master without Python of its own: it loads libpython for the unit, makes the steps of a flight, and tells where the
   vehicles are in the end. Arguments: the folder of the unzipped unit, its token, libpython, ticks, and their length. */
#include <dlfcn.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

typedef void *Instance;
typedef Instance Instantiate(const char *, const char *, const char *, bool, bool, bool, bool, const unsigned *, size_t,
                             void *, void *, void *);
typedef int Enter(Instance, bool, double, double, bool, double);
typedef int Call(Instance);
typedef int Step(Instance, double, double, bool, bool *, bool *, bool *, double *);
typedef int Get(Instance, const unsigned *, size_t, double *, size_t);

static void said(void *environment, int status, const char *category, const char *message)
{
    fprintf(stderr, "[%d] %s\n", status, message);
}

static void *found(void *library, const char *name)
{
    void *function = dlsym(library, name);
    if (!function) {
        fprintf(stderr, "%s\n", dlerror());
        exit(1);
    }
    return function;
}

int main(int count, char **words)
{
    char library[4096], resources[4096];
    if (count != 6 || !dlopen(words[3], RTLD_NOW | RTLD_GLOBAL)) return 1;
    snprintf(library, sizeof library, "%s/binaries/x86_64-linux/OutriderUnit.so", words[1]);
    snprintf(resources, sizeof resources, "%s/resources/", words[1]);
    void *unit = dlopen(library, RTLD_NOW);
    if (!unit) return 1;
    Instantiate *make = found(unit, "fmi3InstantiateCoSimulation");
    Instance world = make("world", words[2], resources, false, false, false, false, NULL, 0, NULL, (void *)said, NULL);
    if (!world) return 1;
    ((Enter *)found(unit, "fmi3EnterInitializationMode"))(world, false, 0.0, 0.0, false, 0.0);
    ((Call *)found(unit, "fmi3ExitInitializationMode"))(world);
    Step *step = found(unit, "fmi3DoStep");
    double dt = atof(words[5]);
    for (int tick = 0; tick < atoi(words[4]); tick++) {
        bool event, end, early;
        double last;
        if (step(world, tick * dt, dt, true, &event, &end, &early, &last)) return 1;
    }
    unsigned places[] = {1, 2, 7, 8}; /* positions of both vehicles */
    double values[4];
    if (((Get *)found(unit, "fmi3GetFloat64"))(world, places, 4, values, 4)) return 1;
    printf("%.17g %.17g %.17g %.17g\n", values[0], values[1], values[2], values[3]);
    ((Call *)found(unit, "fmi3Terminate"))(world);
    ((void (*)(Instance))found(unit, "fmi3FreeInstance"))(world);
    dlclose(unit);
    return 0;
}
