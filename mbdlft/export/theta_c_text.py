"""The texts of Theta in C; names with ``$`` are filled in. C99 and ``math.h``, no allocation."""

DECLARATION = """
/* the nonlinear functions Theta */
enum {
    ${name}_free_inputs = $nu,  /* u: the first inputs */
    ${name}_read_outputs = $ny, /* y: the first outputs */
    ${name}_functions = $nz,
    ${name}_arguments = $no,
    ${name}_out_of_range = 3, /* an argument of Theta is outside of its range, or not a number */
    ${name}_unsolved = 4      /* the values of Theta were not found */
};

/* consistent states at nominal parameters, and values of Theta there */
extern const double ${name}_initial[$nx + 1], ${name}_zeta_at_start[$nz + 1];

/* The functions: zeta (functions), and their slopes (functions x arguments), of omega (arguments).
 *
$functions
 */
int ${name}_theta(const double *omega, double *zeta, double *slopes);

/* Derivatives of the states and outputs y at states x, inputs u and physical values of the parameters.
 *
 * zeta: in, values of Theta near which they are searched; out, those that were found; may be null.
 * Nothing is written unless 0 is returned; rates and y may be null pointers.
 */
int ${name}_derivative(const double *values, const double *x, const double *u, double *zeta,
    double *rates, double *y);
"""

SOURCE = """
$tables
$start
static double table_value(const double *b, const double *v, const double *ends,
    const double *inner, size_t n, double a, int slope)
{
    size_t low = 0, high = n - 1;
    double h, rise, t, left, right, bend;
    if (a < b[0]) {
        return slope ? ends[0] : v[0] + ends[0] * (a - b[0]);
    }
    if (a > b[n - 1]) {
        return slope ? ends[1] : v[n - 1] + ends[1] * (a - b[n - 1]);
    }
    while (high - low > 1) {
        const size_t middle = (low + high) / 2;
        if (a < b[middle]) {
            high = middle;
        } else {
            low = middle;
        }
    }
    h = b[low + 1] - b[low];
    rise = v[low + 1] - v[low];
    t = (a - b[low]) / h;
    if (inner == NULL) {
        return slope ? rise / h : v[low] + t * rise;
    }
    left = h * inner[2 * low] - rise;
    right = h * inner[2 * low + 1] - rise;
    bend = (1.0 - t) * left - t * right;
    if (slope) {
        return (rise + (1.0 - 2.0 * t) * bend - t * (1.0 - t) * (left + right)) / h;
    }
    return v[low] + t * rise + t * (1.0 - t) * bend;
}
"""

EVALUATION = """
int ${name}_theta(const double *omega, double *zeta, double *slopes)
{
    size_t k;
    for (k = 0; k < $no; k++) {
        if (!(omega[k] >= range_low[k] && omega[k] <= range_high[k])) {
            return ${name}_out_of_range;
        }
    }
    theta(omega, zeta, slopes);
    return ${name}_ok;
}

/* x := a^-1 x by Gaussian elimination; a is overwritten. */
static int eliminate(double *a, double *x)
{
    size_t i, j, k;
    for (k = 0; k < $nz; k++) {
        size_t pivot = k;
        for (i = k + 1; i < $nz; i++) {
            if (fabs(a[i * $nz + k]) > fabs(a[pivot * $nz + k])) {
                pivot = i;
            }
        }
        if (!(fabs(a[pivot * $nz + k]) > 0.0)) {
            return 1;
        }
        for (j = 0; j < $nz; j++) {
            const double kept = a[k * $nz + j];
            a[k * $nz + j] = a[pivot * $nz + j];
            a[pivot * $nz + j] = kept;
        }
        {
            const double kept = x[k];
            x[k] = x[pivot];
            x[pivot] = kept;
        }
        for (i = k + 1; i < $nz; i++) {
            const double factor = a[i * $nz + k] / a[k * $nz + k];
            for (j = k; j < $nz; j++) {
                a[i * $nz + j] -= factor * a[k * $nz + j];
            }
            x[i] -= factor * x[k];
        }
    }
    for (k = $nz; k-- > 0;) {
        for (j = k + 1; j < $nz; j++) {
            x[k] -= a[k * $nz + j] * x[j];
        }
        x[k] /= a[k * $nz + k];
    }
    return 0;
}

/* Values with zeta = Theta(c + D zeta), by Newton's method with halved steps. */
static int solve_theta(const double *value, const double *known, double *zeta, double *omega)
{
    double at[$nz], slopes[$nz * $no], step[$nz], from[$nz], scale[$nz], a[$nz * $nz];
    double last = HUGE_VAL, factor = 1.0;
    size_t i, j, k;
    int turn, more = 1;
    for (turn = 0; turn < 400; turn++) {
        double worst = 0.0, size = 0.0;
        for (k = 0; k < $no; k++) {
            omega[k] = known[k];
            for (j = 0; j < $nz; j++) {
                omega[k] += value[omega_row[k] * $width + zeta_column[j]] * zeta[j];
            }
        }
        theta(omega, at, slopes);
        for (i = 0; turn > 0 && i < $nz; i++) {
            size += pow((at[i] - zeta[i]) / scale[i], 2.0);
        }
        if (turn > 0 && factor > 1e-6 && !(sqrt(size) < last * (1.0 - 0.1 * factor))
            && !(sqrt(size) <= 1e-12)) {
            factor *= 0.5;
            for (i = 0; i < $nz; i++) {
                zeta[i] = from[i] + factor * step[i];
            }
            continue;
        }
        last = 0.0;
        for (i = 0; i < $nz; i++) {
            scale[i] = fabs(zeta[i]) + fabs(at[i]);
            for (k = 0; k < $no; k++) {
                double terms = fabs(known[k]);
                for (j = 0; j < $nz; j++) {
                    terms += fabs(value[omega_row[k] * $width + zeta_column[j]] * zeta[j]);
                }
                scale[i] += fabs(slopes[i * $no + k]) * terms;
            }
            from[i] = zeta[i];
            step[i] = at[i] - zeta[i];
            if (!isfinite(step[i])) {
                return 1;
            }
            worst = fmax(worst, fabs(step[i]) / fmax(scale[i], 1e-300));
            scale[i] = fmax(scale[i], 1.0);
            last += pow(step[i] / scale[i], 2.0);
        }
        if (worst <= 1e-12 && more-- == 0) {
            return 0;
        }
        last = sqrt(last);
        factor = 1.0;
        for (i = 0; i < $nz; i++) {
            for (j = 0; j < $nz; j++) {
                a[i * $nz + j] = i == j ? 1.0 : 0.0;
                for (k = 0; k < $no; k++) {
                    a[i * $nz + j] -= slopes[i * $no + k]
                        * value[omega_row[k] * $width + zeta_column[j]];
                }
            }
        }
        if (eliminate(a, step) != 0) {
            return 1;
        }
        for (i = 0; i < $nz; i++) {
            zeta[i] += step[i];
        }
    }
    return 1;
}

/* What states, inputs and the constant 1 give in a row of the value. */
static double row_of(const double *value, size_t row, const double *x, const double *u)
{
    double sum = $one;
    size_t k;
    for (k = 0; k < count_x; k++) {
        sum += value[row * $width + k] * x[k];
    }
    for (k = 0; k < count_u; k++) {
        sum += value[row * $width + u_column[k]] * u[k];
    }
    return sum;
}

int ${name}_derivative(const double *values, const double *x, const double *u, double *zeta,
    double *rates, double *y)
{
    double delta[$np + 1], value[$height * $width + 1], known[$no], omega[$no], found[$nz];
    size_t j, k;
    int status = deltas_of(values, delta);
    if (status == ${name}_ok) {
        status = matrices_of(delta, value);
    }
    if (status != ${name}_ok) {
        return status;
    }
    for (k = 0; k < $no; k++) {
        known[k] = row_of(value, omega_row[k], x, u);
    }
    for (k = 0; k < $nz; k++) {
        found[k] = zeta != NULL ? zeta[k] : ${name}_zeta_at_start[k];
    }
    if (solve_theta(value, known, found, omega) != 0) {
        return ${name}_unsolved;
    }
    status = ${name}_theta(omega, found, NULL);
    if (status != ${name}_ok) {
        return status;
    }
    for (k = 0; k < count_x + count_y; k++) {
        double sum = row_of(value, k, x, u);
        for (j = 0; j < $nz; j++) {
            sum += value[k * $width + zeta_column[j]] * found[j];
        }
        if (k < count_x && rates != NULL) {
            rates[k] = sum;
        }
        if (k >= count_x && y != NULL) {
            y[k - count_x] = sum;
        }
    }
    for (k = 0; zeta != NULL && k < $nz; k++) {
        zeta[k] = found[k];
    }
    return ${name}_ok;
}
"""
