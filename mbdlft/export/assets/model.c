/* Written by mbdlft. Model: <<model>>. See <<stem>>.h. C99. */
#include "<<stem>>.h"

#include <float.h>
#include <stddef.h>

<<generated>>
<<tables>>
typedef int (*generated)(const double **, double **, int *, double *, int);
static int is_outside(const double *values)
{
<% if np %>
    size_t k;
    for (k = 0; k < <<np>>; k++) {
        const double slack = 1e-9 * (<<name>>_high[k] - <<name>>_low[k]);
        if (!(values[k] >= <<name>>_low[k] - slack && values[k] <= <<name>>_high[k] + slack)) {
            return 1;
        }
    }
<% endif %>
    (void)values;
    return 0;
}

/* The value of an LFT, row by row. */
static int evaluate(generated function, const double *values, double *value)
{
    double work[<<work>>], condition = 0.0;
    const double *arguments[<<arguments>>] = {values};
    double *results[<<results>>] = {value, &condition};
    int integers[<<integers>>];
    if (is_outside(values)) {
        return <<name>>_outside;
    }
    if (function(arguments, results, integers, work, 0) != 0 || !(condition * DBL_EPSILON <= 1.0)) {
        return <<name>>_singular;
    }
    return <<name>>_ok;
}

/* Rows and columns of the value, from a place on, to a target that is not null. */
static void copy(const double *place, size_t rows, size_t columns, double *target)
{
    size_t i, j;
    for (i = 0; target != NULL && i < rows; i++) {
        for (j = 0; j < columns; j++) {
            target[i * columns + j] = place[i * (<<nx>> + <<nu>>) + j];
        }
    }
}

int <<name>>_matrices(const double *values, double *A, double *B, double *C, double *D)
{
    double value[<<size>>], *const below = value + <<nx>> * (<<nx>> + <<nu>>);
    const int status = evaluate(<<name>>_f_value, values, value);
    if (status == <<name>>_ok) {
        copy(value, <<nx>>, <<nx>>, A);
        copy(value + <<nx>>, <<nx>>, <<nu>>, B);
        copy(below, <<ny>>, <<nx>>, C);
        copy(below + <<nx>>, <<ny>>, <<nu>>, D);
    }
    return status;
}
<% if nt %>

int <<name>>_trim(const double *values, double *trim)
{
    double value[<<nt>>];
    const int status = evaluate(<<name>>_f_trim, values, value);
    size_t k;
    for (k = 0; status == <<name>>_ok && k < <<nt>>; k++) {
        trim[k] = value[k];
    }
    return status;
}
<% endif %>
<% if theta %>

int <<name>>_theta(const double *omega, double *zeta, double *slopes)
{
    double work[<<work>>];
    const double *arguments[<<arguments>>] = {omega};
    double *results[<<results>>] = {zeta, slopes};
    int integers[<<integers>>];
    size_t k;
    for (k = 0; k < <<no>>; k++) {
        if (!(omega[k] >= range_low[k] && omega[k] <= range_high[k])) {
            return <<name>>_out_of_range;
        }
    }
    return <<name>>_f_theta(arguments, results, integers, work, 0);
}

/* Values with zeta = Theta(c + D zeta), by Newton's method with halved steps. */
static int solve_theta(const double *value, const double *x, const double *u, double *zeta,
    double *omega)
{
    double residual[<<nz>>], terms[<<nz>>], newton[<<nz>>], step[<<nz>>], from[<<nz>>], scale[<<nz>>], work[<<work>>];
    const double *arguments[<<arguments>>] = {value, x, u, zeta};
    double *results[<<results>>] = {residual, terms, newton, omega};
    double last = HUGE_VAL, factor = 1.0;
    int turn, more = 1, integers[<<integers>>];
    size_t i;
    for (turn = 0; turn < 400; turn++) {
        double worst = 0.0, size = 0.0;
        (void)<<name>>_f_newton(arguments, results, integers, work, 0);
        for (i = 0; turn > 0 && i < <<nz>>; i++) {
            size += residual[i] / scale[i] * (residual[i] / scale[i]);
        }
        size = sqrt(size);
        if (turn > 0 && factor > 1e-6 && !(size < last * (1.0 - 0.1 * factor)) && !(size <= 1e-12)) {
            factor *= 0.5;
            for (i = 0; i < <<nz>>; i++) {
                zeta[i] = from[i] + factor * step[i];
            }
            continue;
        }
        last = 0.0;
        for (i = 0; i < <<nz>>; i++) {
            if (!isfinite(residual[i]) || !isfinite(newton[i])) {
                return 1;
            }
            worst = fmax(worst, fabs(residual[i]) / fmax(terms[i], 1e-300));
            scale[i] = fmax(terms[i], 1.0);
            last += residual[i] / scale[i] * (residual[i] / scale[i]);
        }
        if (worst <= 1e-12 && more-- == 0) {
            return 0;
        }
        last = sqrt(last);
        factor = 1.0;
        for (i = 0; i < <<nz>>; i++) {
            from[i] = zeta[i];
            zeta[i] += step[i] = newton[i];
        }
    }
    return 1;
}

int <<name>>_derivative(const double *values, const double *x, const double *u, double *zeta,
    double *rates, double *y)
{
    double value[<<size>>], omega[<<no>>], solution[<<nz>>], work[<<work>>];
    const double *arguments[<<arguments>>] = {value, x, u, solution};
    double *results[<<results>>] = {rates, y};
    int status = evaluate(<<name>>_f_value, values, value), integers[<<integers>>];
    size_t k;
    if (status != <<name>>_ok) {
        return status;
    }
    for (k = 0; k < <<nz>>; k++) {
        solution[k] = zeta != NULL ? zeta[k] : <<name>>_zeta_at_start[k];
    }
    if (solve_theta(value, x, u, solution, omega) != 0) {
        return <<name>>_unsolved;
    }
    status = <<name>>_theta(omega, NULL, NULL);
    for (k = 0; status == <<name>>_ok && zeta != NULL && k < <<nz>>; k++) {
        zeta[k] = solution[k];
    }
    return status != <<name>>_ok ? status : <<name>>_f_rates(arguments, results, integers, work, 0);
}
<% endif %>
