"""The texts of the C files; names with ``$`` are filled in. C99 and ``math.h``, no allocation."""

HEADER = """\
/* A model with its parameters left in, evaluated at physical values. Written by mbdlft.
 *
 * Model: $model
$table
 */
#ifndef $guard
#define $guard

#ifdef __cplusplus
extern "C" {
#endif

/* sizes */
enum {
    ${name}_parameters = $np,
    ${name}_states = $nx,
    ${name}_inputs = $nu,
    ${name}_outputs = $ny,
    ${name}_trimmed = $nt
};

/* what a function returns */
enum {
    ${name}_ok = 0,
    ${name}_outside = 1, /* a value is outside its range, or not a number */
    ${name}_singular = 2 /* the model is singular there, and has no value */
};

/* places of the parameters in an array of values */
enum {
$indices    ${name}_end
};
$tables
/* State matrices at physical values, row by row: A (states x states), B (states x inputs),
 * C (outputs x states), D (outputs x inputs).
 *
 * values: one number for each parameter, in its unit. Nothing is written unless 0 is returned; a matrix
 * that is not needed, or is empty, may be a null pointer. Needs $stack bytes of the stack; any number
 * of threads may call it.
 */
int ${name}_matrices(const double *values, double *A, double *B, double *C, double *D);
$trim
#ifdef __cplusplus
}
#endif

#endif
"""

TABLES = """
/* ranges and nominal values, in the units above */
extern const double ${name}_low[$np], ${name}_nominal[$np], ${name}_high[$np];
"""

TRIM_DECLARATION = """
/* What holds the equilibrium at physical values: $nt numbers. As above. */
int ${name}_trim(const double *values, double *trim);
"""

SOURCE = """\
/* Written by mbdlft. Model: $model. See $stem.h. C99. */
#include "$stem.h"

#include <float.h>
#include <math.h>
#include <stddef.h>
"""

DELTAS = """
/* Normalized deltas of physical values. */
static int deltas_of(const double *values, double *delta)
{
    size_t k;
    for (k = 0; k < $np; k++) {
        const double slack = 1e-9 * (${name}_high[k] - ${name}_low[k]);
        double distance = values[k];
        if (!(values[k] >= ${name}_low[k] - slack && values[k] <= ${name}_high[k] + slack)) {
            return ${name}_outside;
        }
        if (divisor[k] > 0.0) {
            distance = tan((distance * factor[k] - reference[k]) / divisor[k]);
        }
        distance -= b0[k];
        delta[k] = distance / (gain[k] - a1[k] * distance);
    }
    return ${name}_ok;
}
"""

NO_DELTAS = """
static int deltas_of(const double *values, double *delta)
{
    (void)values;
    delta[0] = 0.0;
    return ${name}_ok;
}
"""

LOOP = """
/* The number with which a largest size becomes one between 1/2 and 1: a power of two, so nothing is
   rounded. */
static double power_of_two(double largest)
{
    int exponent;
    if (!(largest > 0.0)) {
        return 1.0;
    }
    (void)frexp(largest, &exponent);
    return ldexp(1.0, -exponent);
}

/* Factors of I - inner Delta, whose rows and columns are first brought to one size, with partial
   pivoting; a pivot that is nothing but rounding is a status. */
static int factorize(size_t n, const double *inner, const double *d, double *work,
    double *row_scale, double *column_scale, size_t *pivot)
{
    size_t i, j, k;
    for (i = 0; i < n; i++) {
        double largest = 0.0;
        for (j = 0; j < n; j++) {
            work[i * n + j] = (i == j ? 1.0 : 0.0) - inner[i * n + j] * d[j];
            largest = fmax(largest, fabs(work[i * n + j]));
        }
        row_scale[i] = power_of_two(largest);
    }
    for (j = 0; j < n; j++) {
        double largest = 0.0;
        for (i = 0; i < n; i++) {
            work[i * n + j] *= row_scale[i];
            largest = fmax(largest, fabs(work[i * n + j]));
        }
        column_scale[j] = power_of_two(largest);
        for (i = 0; i < n; i++) {
            work[i * n + j] *= column_scale[j];
        }
    }
    for (k = 0; k < n; k++) {
        pivot[k] = k;
        for (i = k + 1; i < n; i++) {
            if (fabs(work[i * n + k]) > fabs(work[pivot[k] * n + k])) {
                pivot[k] = i;
            }
        }
        if (!(fabs(work[pivot[k] * n + k]) > (double)n * DBL_EPSILON)) {
            return 2;
        }
        for (j = 0; pivot[k] != k && j < n; j++) {
            const double kept = work[k * n + j];
            work[k * n + j] = work[pivot[k] * n + j];
            work[pivot[k] * n + j] = kept;
        }
        for (i = k + 1; i < n; i++) {
            const double factor = work[i * n + k] / work[k * n + k];
            work[i * n + k] = factor;
            for (j = k + 1; factor != 0.0 && j < n; j++) {
                work[i * n + j] -= factor * work[k * n + j];
            }
        }
    }
    return 0;
}

/* x := (I - inner Delta)^-1 x with the factors. */
static void solve(size_t n, const double *work, const double *row_scale,
    const double *column_scale, const size_t *pivot, double *x)
{
    size_t i, j;
    for (i = 0; i < n; i++) {
        x[i] *= row_scale[i];
    }
    for (i = 0; i < n; i++) {
        const double kept = x[i];
        x[i] = x[pivot[i]];
        x[pivot[i]] = kept;
    }
    for (i = 1; i < n; i++) {
        for (j = 0; j < i; j++) {
            x[i] -= work[i * n + j] * x[j];
        }
    }
    for (i = n; i-- > 0;) {
        for (j = i + 1; j < n; j++) {
            x[i] -= work[i * n + j] * x[j];
        }
        x[i] /= work[i * n + i];
    }
    for (i = 0; i < n; i++) {
        x[i] *= column_scale[i];
    }
}

/* value += last Delta (I - inner Delta)^-1 first, entry (i, k) at row[i] + column[k].

   first is M12, inner M11 and last M21; or their transposes, where that side is thinner. work has
   n (n + 4) numbers. Each solution is improved once by its residual: terms of the sums may cancel. */
static int close_loop(size_t n, size_t rows, size_t m, const double *inner, const double *first,
    const double *last, const size_t *row, const size_t *column, const double *d, double *work,
    size_t *pivot, double *value)
{
    double *const row_scale = work + n * n, *const column_scale = row_scale + n;
    double *const x = column_scale + n, *const rest = x + n;
    size_t i, j, k;
    if (factorize(n, inner, d, work, row_scale, column_scale, pivot) != 0) {
        return 2;
    }
    for (k = 0; k < m; k++) {
        for (i = 0; i < n; i++) {
            x[i] = first[i * m + k];
        }
        solve(n, work, row_scale, column_scale, pivot, x);
        for (i = 0; i < n; i++) {
            rest[i] = first[i * m + k] - x[i];
            for (j = 0; j < n; j++) {
                rest[i] += inner[i * n + j] * (d[j] * x[j]);
            }
        }
        solve(n, work, row_scale, column_scale, pivot, rest);
        for (i = 0; i < n; i++) {
            x[i] = d[i] * (x[i] + rest[i]);
        }
        for (i = 0; i < rows; i++) {
            double sum = 0.0;
            for (j = 0; j < n; j++) {
                sum += last[i * n + j] * x[j];
            }
            value[row[i] + column[k]] += sum;
        }
    }
    return 0;
}
"""

MATRICES = """
/* Part of the value, from a row and a column on. */
static void copy(const double *value, size_t row, size_t rows, size_t column, size_t columns,
    double *target)
{
    size_t i, j;
    for (i = 0; target != NULL && i < rows; i++) {
        for (j = 0; j < columns; j++) {
            target[i * columns + j] = value[(row + i) * ($nx + $nu) + column + j];
        }
    }
}

int ${name}_matrices(const double *values, double *A, double *B, double *C, double *D)
{
    double delta[$np + 1], value[($nx + $ny) * ($nx + $nu) + 1];
    int status = deltas_of(values, delta);
    if (status == ${name}_ok) {
        status = matrices_of(delta, value);
    }
    if (status != ${name}_ok) {
        return status;
    }
    copy(value, 0, $nx, 0, $nx, A);
    copy(value, 0, $nx, $nx, $nu, B);
    copy(value, $nx, $ny, 0, $nx, C);
    copy(value, $nx, $ny, $nx, $nu, D);
    return ${name}_ok;
}
"""

TRIM = """
int ${name}_trim(const double *values, double *trim)
{
    double delta[$np + 1], value[$nt + 1];
    size_t k;
    int status = deltas_of(values, delta);
    if (status == ${name}_ok) {
        status = trim_of(delta, value);
    }
    for (k = 0; status == ${name}_ok && k < $nt; k++) {
        trim[k] = value[k];
    }
    return status;
}
"""
