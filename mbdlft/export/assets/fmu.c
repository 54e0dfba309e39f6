/* A functional mock-up unit of a model, its parameters left in. Written by mbdlft.
 *
 * x' = A x + B u, y = C x + D u with matrices of <<stem>>.h at the parameters that are set. A step of
 * co-simulation holds the inputs, and is then exact: x(t + h) = exp(A h) x + integral of exp(A s) ds B u.
 */
#include "<<stem>>.c"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define FMU_EXPORT __declspec(dllexport)
#else
#define FMU_EXPORT __attribute__((visibility("default")))
#endif

enum { NP = <<np>>, NX = <<nx>>, NU = <<nu>>, NY = <<ny>>, NT = <<nt>>, N = NX + NU };
/* value references: time, then these, each from here on */
enum { VALUES = 1, INPUTS = VALUES + NP, STATES = INPUTS + NU, RATES = STATES + NX, OUTPUTS = RATES + NX,
       TRIM = OUTPUTS + NY, END = TRIM + NT };
enum { OK = 0, ERROR = 3 };
typedef unsigned int reference;

typedef struct {
    double time, values[NP + 1], u[NU + 1], x[NX + 1], trim[NT + 1];
    double A[NX * NX + 1], B[NX * NU + 1], C[NY * NX + 1], D[NY * NU + 1];
    double step, change[N * N + 1], kept[N + 1]; /* of a step of this length: diag(kept) + change */
    int current; /* whether the matrices are those at the values */
    void *environment; /* this and what follows is given, and no part of a state */
    void (*log)(void);
    char name[256];
} instance;

static void tell(const instance *m, const char *text);

static void start(instance *m)
{
    size_t k;
    m->time = 0.0;
    m->current = 0;
    m->step = -1.0;
    memset(m->u, 0, sizeof m->u);
    memset(m->x, 0, sizeof m->x);
<% if np %>
    for (k = 0; k < NP; k++) {
        m->values[k] = <<name>>_nominal[k];
    }
<% endif %>
    (void)k;
}

/* The matrices at the values. */
static int update(instance *m)
{
    int status;
    if (m->current) {
        return OK;
    }
    status = <<name>>_matrices(m->values, m->A, m->B, m->C, m->D);
<% if nt %>
    if (status == <<name>>_ok) {
        status = <<name>>_trim(m->values, m->trim);
    }
<% endif %>
    if (status != <<name>>_ok) {
        tell(m, status == <<name>>_outside ? "a parameter is outside its range, or not a number"
                                           : "the model is singular at these parameters");
        return ERROR;
    }
    m->current = 1;
    m->step = -1.0;
    return OK;
}

/* d unknown / d known: entries of A, B, C, D; 0 if they are not related. */
static double slope(const instance *m, reference unknown, reference known)
{
    const int by_state = known >= STATES && known < RATES, by_input = known >= INPUTS && known < STATES;
    if (unknown >= RATES && unknown < OUTPUTS) {
        const size_t i = unknown - RATES;
        return by_state ? m->A[i * NX + known - STATES] : by_input ? m->B[i * NU + known - INPUTS] : 0.0;
    }
    if (unknown >= OUTPUTS && unknown < TRIM) {
        const size_t i = unknown - OUTPUTS;
        return by_state ? m->C[i * NX + known - STATES] : by_input ? m->D[i * NU + known - INPUTS] : 0.0;
    }
    return 0.0;
}

static int get(instance *m, reference which, double *value)
{
    reference k;
    if (which >= RATES && which < END && update(m) != OK) {
        return ERROR;
    }
    if (which == 0) {
        *value = m->time;
    } else if (which < INPUTS) {
        *value = m->values[which - VALUES];
    } else if (which < STATES) {
        *value = m->u[which - INPUTS];
    } else if (which < RATES) {
        *value = m->x[which - STATES];
    } else if (which < TRIM) {
        *value = 0.0;
        for (k = 0; k < NX; k++) {
            *value += slope(m, which, STATES + k) * m->x[k];
        }
        for (k = 0; k < NU; k++) {
            *value += slope(m, which, INPUTS + k) * m->u[k];
        }
    } else if (which < END) {
        *value = m->trim[which - TRIM];
    } else {
        tell(m, "there is no variable of this number");
        return ERROR;
    }
    return OK;
}

static int set(instance *m, reference which, double value)
{
    if (which >= VALUES && which < INPUTS) {
        m->values[which - VALUES] = value;
        m->current = 0;
    } else if (which >= INPUTS && which < STATES) {
        m->u[which - INPUTS] = value;
    } else if (which >= STATES && which < RATES) {
        m->x[which - STATES] = value;
    } else {
        tell(m, "parameters, inputs and states can be set, and nothing else");
        return ERROR;
    }
    return OK;
}

/* target = a b, all (N, N) */
static void multiply(const double *a, const double *b, double *target)
{
    size_t i, j, k;
    memset(target, 0, sizeof(double) * N * N);
    for (i = 0; i < N; i++) {
        for (k = 0; k < N; k++) {
            for (j = 0; a[i * N + k] != 0.0 && j < N; j++) {
                target[i * N + j] += a[i * N + k] * b[k * N + j];
            }
        }
    }
}

/* exp([A B ; 0 0] h) = diag(kept) + F: the series after a division by a power of two, then squares.
 *
 * 1 is kept apart on the diagonal until it has changed by a half: a slow pole beside a fast one would lose
 * the digits of its small changes in it.
 */
static int prepare(instance *m, double h)
{
    double norm = 0.0, *a, *b, *F = m->change, *const kept = m->kept;
    int halvings = 0, term;
    size_t i, j;
    if (update(m) != OK) {
        return ERROR;
    }
    if (m->step == h) {
        return OK;
    }
    a = calloc(2 * N * N + 1, sizeof *a);
    if (a == NULL) {
        tell(m, "there is no memory");
        return ERROR;
    }
    b = a + N * N;
    for (i = 0; i < NX; i++) {
        double sum = 0.0;
        for (j = 0; j < N; j++) {
            a[i * N + j] = h * (j < NX ? m->A[i * NX + j] : m->B[i * NU + j - NX]);
            sum += fabs(a[i * N + j]);
        }
        norm = fmax(norm, sum);
    }
    (void)frexp(norm, &halvings);
    halvings = halvings > 0 ? halvings : 0;
    for (i = 0; i < N * N; i++) {
        a[i] = ldexp(a[i], -halvings);
    }
    memcpy(F, a, sizeof(double) * N * N);
    for (term = 18; term > 1; term--) { /* F = a (I + F / term) */
        for (i = 0; i < N * N; i++) {
            F[i] /= term;
        }
        multiply(a, F, b);
        for (i = 0; i < N * N; i++) {
            F[i] = a[i] + b[i];
        }
    }
    for (i = 0; i < N; i++) {
        kept[i] = 1.0;
    }
    for (; halvings > 0; halvings--) {
        multiply(F, F, b);
        for (i = 0; i < N; i++) {
            for (j = 0; j < N; j++) {
                b[i * N + j] += (kept[i] + kept[j]) * F[i * N + j];
            }
        }
        memcpy(F, b, sizeof(double) * N * N);
        for (i = 0; i < N; i++) {
            if (kept[i] != 0.0 && fabs(F[i * N + i]) > 0.5) {
                F[i * N + i] += kept[i];
                kept[i] = 0.0;
            }
        }
    }
    free(a);
    m->step = h;
    return OK;
}

static int advance(instance *m, double from, double h)
{
    double next[NX + 1];
    size_t i, j;
    if (!(h > 0.0) || !isfinite(h)) {
        tell(m, "a step is positive");
        return ERROR;
    }
    if (prepare(m, h) != OK) {
        return ERROR;
    }
    for (i = 0; i < NX; i++) {
        next[i] = 0.0;
        for (j = 0; j < N; j++) {
            next[i] += m->change[i * N + j] * (j < NX ? m->x[j] : m->u[j - NX]);
        }
        next[i] += m->kept[i] * m->x[i];
        if (!isfinite(next[i])) {
            tell(m, "a state overflows in this step, or an input is not a number");
            return ERROR;
        }
    }
    memcpy(m->x, next, sizeof(double) * NX);
    m->time = from + h;
    return OK;
}

static instance *create(const char *name, const char *token, void *environment, void (*log)(void))
{
    instance *m = calloc(1, sizeof *m);
    if (m != NULL) {
        m->environment = environment;
        m->log = log;
        strncpy(m->name, name != NULL ? name : "", sizeof m->name - 1);
        start(m);
        if (token == NULL || strcmp(token, "<<token>>") != 0) {
            tell(m, "the description is that of another unit");
            free(m);
            m = NULL;
        }
    }
    return m;
}

static instance *copied(const instance *m)
{
    instance *copy = malloc(sizeof *copy);
    if (copy != NULL) {
        memcpy(copy, m, sizeof *copy);
    }
    return copy;
}

/* The numbers of a state; what an environment has given stays. */
static void restore(instance *m, const instance *state)
{
    memcpy(m, state, offsetof(instance, environment));
}

/* States of the unit, as an environment stores them. */
static int save(const instance *m, void **state)
{
    free(*state);
    return (*state = copied(m)) != NULL ? OK : ERROR;
}

static int forget(void **state)
{
    free(*state);
    *state = NULL;
    return OK;
}

static int write_state(const void *state, void *bytes, size_t size)
{
    return size < sizeof(instance) ? ERROR : (memcpy(bytes, state, sizeof(instance)), OK);
}

static int read_state(const instance *m, const void *bytes, size_t size, void **state)
{
    if (size < sizeof(instance) || (*state = copied(m)) == NULL) {
        return ERROR;
    }
    memcpy(*state, bytes, sizeof(instance));
    return OK;
}

static int get_all(instance *m, const reference which[], size_t count, double values[])
{
    size_t k;
    int status = OK;
    for (k = 0; k < count && status == OK; k++) {
        status = get(m, which[k], values + k);
    }
    return status;
}

static int set_all(instance *m, const reference which[], size_t count, const double values[])
{
    size_t k;
    int status = OK;
    for (k = 0; k < count && status == OK; k++) {
        status = set(m, which[k], values[k]);
    }
    return status;
}

static int expect(const instance *m, size_t count, size_t expected)
{
    return count == expected ? OK : (tell(m, "there is another number of states or of indicators"), ERROR);
}

static int get_states(const instance *m, double x[], size_t count)
{
    return expect(m, count, NX) == OK ? (memcpy(x, m->x, sizeof(double) * NX), OK) : ERROR;
}

static int set_states(instance *m, const double x[], size_t count)
{
    return expect(m, count, NX) == OK ? (memcpy(m->x, x, sizeof(double) * NX), OK) : ERROR;
}

static int get_rates(instance *m, double rates[], size_t count)
{
    size_t k;
    int status = expect(m, count, NX) == OK ? update(m) : ERROR;
    for (k = 0; k < count && status == OK; k++) {
        status = get(m, (reference)(RATES + k), rates + k);
    }
    return status;
}

static int get_nominals(const instance *m, double values[], size_t count)
{
    size_t k;
    const int status = expect(m, count, NX);
    for (k = 0; k < NX && status == OK; k++) {
        values[k] = 1.0;
    }
    return status;
}

/* J' seed or J seed; slopes by parameters are refused */
static int derivatives(instance *m, const reference unknowns[], size_t rows, const reference knowns[],
    size_t columns, const double seed[], double result[], int is_adjoint)
{
    size_t i, j;
    if (update(m) != OK) {
        return ERROR;
    }
    memset(result, 0, sizeof(double) * (is_adjoint ? columns : rows));
    for (i = 0; i < rows; i++) {
        for (j = 0; j < columns; j++) {
            const int by_parameter = knowns[j] >= VALUES && knowns[j] < INPUTS;
            if (unknowns[i] >= END || knowns[j] >= END || (unknowns[i] >= RATES && by_parameter)) {
                tell(m, "there are slopes by states and inputs only");
                return ERROR;
            }
            const double entry = unknowns[i] == knowns[j] ? 1.0 : slope(m, unknowns[i], knowns[j]);
            result[is_adjoint ? j : i] += entry * seed[is_adjoint ? i : j];
        }
    }
    return OK;
}

<% if fmi == 2 %>
<% include "fmi2.c" %>
<% else %>
<% include "fmi3.c" %>
<% endif %>
