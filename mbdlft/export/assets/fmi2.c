/* The functions of FMI 2.0, with the types of its platform "default". */
typedef void *component;
typedef const char *text;
typedef struct {
    void (*logger)(void *, text, int, text, text, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} callbacks;
typedef struct {
    int newDiscreteStatesNeeded, terminateSimulation, nominalsOfContinuousStatesChanged,
        valuesOfContinuousStatesChanged, nextEventTimeDefined;
    double nextEventTime;
} event_info;

static void tell(const instance *m, text message)
{
    if (m->log != NULL) {
        ((void (*)(void *, text, int, text, text, ...))m->log)(
            m->environment, m->name, ERROR, "error", "%s", message);
    }
}

#define API(name) FMU_EXPORT int fmi2##name
#define NONE(name, type) \
    int fmi2Get##name(component c, const reference r[], size_t n, type v[]); \
    int fmi2Set##name(component c, const reference r[], size_t n, const type v[]); \
    API(Get##name)(component c, const reference r[], size_t n, type v[]) \
    { \
        return n == 0 ? OK : ERROR; \
    } \
    API(Set##name)(component c, const reference r[], size_t n, const type v[]) \
    { \
        return n == 0 ? OK : ERROR; \
    }
#define STATUS(name, type) \
    API(Get##name##Status)(component c, int kind, type *v) \
    { \
        return 2; \
    }

FMU_EXPORT text fmi2GetTypesPlatform(void) { return "default"; }
FMU_EXPORT text fmi2GetVersion(void) { return "2.0"; }
API(SetDebugLogging)(component c, int on, size_t n, const text categories[])
{
    return OK;
}
FMU_EXPORT component fmi2Instantiate(
    text name, int type, text token, text resources, const callbacks *given, int visible, int logging)
{
    return create(name, token, given->environment, (void (*)(void))given->logger);
}
FMU_EXPORT void fmi2FreeInstance(component c) { free(c); }
API(SetupExperiment)(component c, int has_tolerance, double tolerance, double from, int has_end, double to)
{
    ((instance *)c)->time = from;
    return OK;
}
API(EnterInitializationMode)(component c) { return OK; }
API(ExitInitializationMode)(component c) { return update(c); }
API(Terminate)(component c) { return OK; }
API(Reset)(component c) { return start(c), OK; }
API(GetReal)(component c, const reference r[], size_t n, double v[]) { return get_all(c, r, n, v); }
API(SetReal)(component c, const reference r[], size_t n, const double v[]) { return set_all(c, r, n, v); }
NONE(Integer, int)
NONE(Boolean, int)
NONE(String, text)
API(GetFMUstate)(component c, void **state) { return save(c, state); }
API(SetFMUstate)(component c, void *state) { return restore(c, state), OK; }
API(FreeFMUstate)(component c, void **state) { return forget(state); }
API(SerializedFMUstateSize)(component c, void *state, size_t *size) { return *size = sizeof(instance), OK; }
API(SerializeFMUstate)(component c, void *state, char bytes[], size_t size)
{
    return write_state(state, bytes, size);
}
API(DeSerializeFMUstate)(component c, const char bytes[], size_t size, void **state)
{
    return read_state(c, bytes, size, state);
}
API(GetDirectionalDerivative)(component c, const reference unknowns[], size_t rows, const reference knowns[],
    size_t columns, const double seed[], double result[])
{
    return derivatives(c, unknowns, rows, knowns, columns, seed, result, 0);
}

/* model exchange */
API(EnterEventMode)(component c) { return OK; }
API(NewDiscreteStates)(component c, event_info *info)
{
    memset(info, 0, sizeof *info);
    return OK;
}
API(EnterContinuousTimeMode)(component c) { return OK; }
API(CompletedIntegratorStep)(component c, int no_set, int *event, int *end)
{
    *event = *end = 0;
    return OK;
}
API(SetTime)(component c, double time) { return ((instance *)c)->time = time, OK; }
API(SetContinuousStates)(component c, const double x[], size_t n) { return set_states(c, x, n); }
API(GetDerivatives)(component c, double rates[], size_t n) { return get_rates(c, rates, n); }
API(GetEventIndicators)(component c, double z[], size_t n) { return expect(c, n, 0); }
API(GetContinuousStates)(component c, double x[], size_t n) { return get_states(c, x, n); }
API(GetNominalsOfContinuousStates)(component c, double v[], size_t n) { return get_nominals(c, v, n); }

/* co-simulation */
API(SetRealInputDerivatives)(component c, const reference r[], size_t n, const int order[], const double v[])
{
    return tell(c, "inputs are held over a step"), ERROR;
}
API(GetRealOutputDerivatives)(component c, const reference r[], size_t n, const int order[], double v[])
{
    return tell(c, "outputs have no derivatives here"), ERROR;
}
API(DoStep)(component c, double from, double step, int no_set)
{
    return advance(c, from, step);
}
API(CancelStep)(component c) { return ERROR; }
STATUS(, int)
STATUS(Real, double)
STATUS(Integer, int)
STATUS(Boolean, int)
STATUS(String, text)
