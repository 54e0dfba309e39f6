/* The functions of FMI 3.0. */
#include <stdint.h>

typedef void *component;
typedef const char *text;
typedef void (*log_message)(void *, int, text, text);

static void tell(const instance *m, text message)
{
    if (m->log != NULL) {
        ((log_message)m->log)(m->environment, ERROR, "error", message);
    }
}

#define API(name) FMU_EXPORT int fmi3##name
#define NONE(name, type) \
    API(Get##name)(component c, const reference r[], size_t n, type v[], size_t count) \
    { \
        return n == 0 ? OK : ERROR; \
    } \
    API(Set##name)(component c, const reference r[], size_t n, const type v[], size_t count) \
    { \
        return n == 0 ? OK : ERROR; \
    }
/* of clocks, which there are none of */
#define CLOCKS(name, ...) \
    API(name)(component c, const reference r[], size_t n, __VA_ARGS__) \
    { \
        return n == 0 ? OK : (tell(c, "there are no clocks"), ERROR); \
    }

FMU_EXPORT text fmi3GetVersion(void) { return "3.0"; }
API(SetDebugLogging)(component c, bool on, size_t n, const text categories[])
{
    return OK;
}
FMU_EXPORT component fmi3InstantiateModelExchange(
    text name, text token, text resources, bool visible, bool logging, void *environment, log_message log)
{
    return create(name, token, environment, (void (*)(void))log);
}
FMU_EXPORT component fmi3InstantiateCoSimulation(text name, text token, text resources, bool visible,
    bool logging, bool events, bool early, const reference required[], size_t count, void *environment,
    log_message log, void (*update_between)(void))
{
    return create(name, token, environment, (void (*)(void))log);
}
FMU_EXPORT component fmi3InstantiateScheduledExecution(text name, text token, text resources, bool visible,
    bool logging, void *environment, log_message log, void (*clock)(void), void (*lock)(void),
    void (*unlock)(void))
{
    return NULL;
}
FMU_EXPORT void fmi3FreeInstance(component c) { free(c); }
API(EnterInitializationMode)(
    component c, bool has_tolerance, double tolerance, double from, bool has_end, double to)
{
    ((instance *)c)->time = from;
    return OK;
}
API(ExitInitializationMode)(component c) { return update(c); }
API(EnterConfigurationMode)(component c) { return OK; }
API(ExitConfigurationMode)(component c) { return OK; }
API(EnterEventMode)(component c) { return OK; }
API(EnterStepMode)(component c) { return OK; }
API(Terminate)(component c) { return OK; }
API(Reset)(component c) { return start(c), OK; }
API(GetFloat64)(component c, const reference r[], size_t n, double v[], size_t count)
{
    return count < n ? ERROR : get_all(c, r, n, v);
}
API(SetFloat64)(component c, const reference r[], size_t n, const double v[], size_t count)
{
    return count < n ? ERROR : set_all(c, r, n, v);
}
NONE(Float32, float)
NONE(Int8, int8_t)
NONE(UInt8, uint8_t)
NONE(Int16, int16_t)
NONE(UInt16, uint16_t)
NONE(Int32, int32_t)
NONE(UInt32, uint32_t)
NONE(Int64, int64_t)
NONE(UInt64, uint64_t)
NONE(Boolean, bool)
NONE(String, text)
CLOCKS(GetBinary, size_t s[], const uint8_t *v[], size_t count)
CLOCKS(SetBinary, const size_t s[], const uint8_t *const v[], size_t count)
CLOCKS(GetClock, bool v[])
CLOCKS(SetClock, const bool v[])
CLOCKS(GetIntervalDecimal, double v[], int q[])
CLOCKS(GetIntervalFraction, uint64_t k[], uint64_t s[], int q[])
CLOCKS(GetShiftDecimal, double v[])
CLOCKS(GetShiftFraction, uint64_t k[], uint64_t s[])
CLOCKS(SetIntervalDecimal, const double v[])
CLOCKS(SetIntervalFraction, const uint64_t k[], const uint64_t s[])
CLOCKS(SetShiftDecimal, const double v[])
CLOCKS(SetShiftFraction, const uint64_t k[], const uint64_t s[])
API(GetNumberOfVariableDependencies)(component c, reference r, size_t *n)
{
    return tell(c, "dependencies are those of the description"), ERROR;
}
API(GetVariableDependencies)(component c, reference r, size_t at[], reference by[], size_t places[],
    int kinds[], size_t n)
{
    return tell(c, "dependencies are those of the description"), ERROR;
}
API(GetFMUState)(component c, void **state) { return save(c, state); }
API(SetFMUState)(component c, void *state) { return restore(c, state), OK; }
API(FreeFMUState)(component c, void **state) { return forget(state); }
API(SerializedFMUStateSize)(component c, void *state, size_t *size) { return *size = sizeof(instance), OK; }
API(SerializeFMUState)(component c, void *state, uint8_t bytes[], size_t size)
{
    return write_state(state, bytes, size);
}
API(DeserializeFMUState)(component c, const uint8_t bytes[], size_t size, void **state)
{
    return read_state(c, bytes, size, state);
}
API(GetDirectionalDerivative)(component c, const reference unknowns[], size_t rows, const reference knowns[],
    size_t columns, const double seed[], size_t seeds, double result[], size_t results)
{
    return seeds < columns || results < rows
        ? ERROR : derivatives(c, unknowns, rows, knowns, columns, seed, result, 0);
}
API(GetAdjointDerivative)(component c, const reference unknowns[], size_t rows, const reference knowns[],
    size_t columns, const double seed[], size_t seeds, double result[], size_t results)
{
    return seeds < rows || results < columns
        ? ERROR : derivatives(c, unknowns, rows, knowns, columns, seed, result, 1);
}
API(EvaluateDiscreteStates)(component c) { return OK; }
API(UpdateDiscreteStates)(component c, bool *again, bool *end, bool *nominals, bool *states, bool *has_next,
    double *next)
{
    *again = *end = *nominals = *states = *has_next = false;
    return OK;
}

/* model exchange */
API(EnterContinuousTimeMode)(component c) { return OK; }
API(CompletedIntegratorStep)(component c, bool no_set, bool *event, bool *end)
{
    *event = *end = false;
    return OK;
}
API(SetTime)(component c, double time) { return ((instance *)c)->time = time, OK; }
API(SetContinuousStates)(component c, const double x[], size_t n) { return set_states(c, x, n); }
API(GetContinuousStateDerivatives)(component c, double rates[], size_t n) { return get_rates(c, rates, n); }
API(GetEventIndicators)(component c, double z[], size_t n) { return expect(c, n, 0); }
API(GetContinuousStates)(component c, double x[], size_t n) { return get_states(c, x, n); }
API(GetNominalsOfContinuousStates)(component c, double v[], size_t n) { return get_nominals(c, v, n); }
API(GetNumberOfEventIndicators)(component c, size_t *n) { return *n = 0, OK; }
API(GetNumberOfContinuousStates)(component c, size_t *n) { return *n = NX, OK; }

/* co-simulation */
API(GetOutputDerivatives)(
    component c, const reference r[], size_t n, const int32_t orders[], double v[], size_t count)
{
    return tell(c, "outputs have no derivatives here"), ERROR;
}
API(DoStep)(component c, double from, double step, bool no_set, bool *event, bool *end, bool *early,
    double *last)
{
    const int status = advance(c, from, step);
    *event = *end = *early = false;
    *last = ((instance *)c)->time;
    return status;
}
API(ActivateModelPartition)(component c, reference clock, double time)
{
    return tell(c, "there are no clocks"), ERROR;
}
