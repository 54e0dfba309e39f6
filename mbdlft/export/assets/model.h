/* A model with its parameters left in, evaluated at physical values. Written by mbdlft.
 *
 * Model: <<model>>
<<table>>
 */
#ifndef MBDLFT_<<name>>_H
#define MBDLFT_<<name>>_H

#ifdef __cplusplus
extern "C" {
#endif

/* sizes */
enum {
    <<name>>_parameters = <<np>>,
    <<name>>_states = <<nx>>,
    <<name>>_inputs = <<nu>>,
    <<name>>_outputs = <<ny>>,
    <<name>>_trimmed = <<nt>>
};

/* what a function returns */
enum {
    <<name>>_ok = 0,
    <<name>>_outside = 1, /* a value is outside its range, or not a number */
    <<name>>_singular = 2 /* the model is singular there, and has no value */
};

/* places of the parameters in an array of values */
enum {
<<indices>>    <<name>>_end
};
<% if np %>

/* ranges and nominal values, in the units above */
extern const double <<name>>_low[<<np>>], <<name>>_nominal[<<np>>], <<name>>_high[<<np>>];
<% endif %>

/* State matrices at physical values, row by row: A (states x states), B (states x inputs),
 * C (outputs x states), D (outputs x inputs).
 *
 * values: one number for each parameter, in its unit. Nothing is written unless 0 is returned; a matrix
 * that is not needed, or is empty, may be a null pointer. Needs <<stack>> bytes of the stack; any number
 * of threads may call it.
 */
int <<name>>_matrices(const double *values, double *A, double *B, double *C, double *D);
<% if nt %>

/* What holds the equilibrium at physical values: <<nt>> numbers. As above. */
int <<name>>_trim(const double *values, double *trim);
<% endif %>
<% if theta %>

/* the nonlinear functions Theta */
enum {
    <<name>>_free_inputs = <<free>>,  /* u: the first inputs */
    <<name>>_read_outputs = <<read>>, /* y: the first outputs */
    <<name>>_functions = <<nz>>,
    <<name>>_arguments = <<no>>,
    <<name>>_out_of_range = 3, /* an argument of Theta is outside of its range, or not a number */
    <<name>>_unsolved = 4      /* the values of Theta were not found */
};

/* consistent states at nominal parameters, and values of Theta there */
extern const double <<name>>_initial[<<nx>> + 1], <<name>>_zeta_at_start[<<nz>> + 1];

/* The functions: zeta (functions), and their slopes (functions x arguments), of omega (arguments).
 *
<<functions>>
 */
int <<name>>_theta(const double *omega, double *zeta, double *slopes);

/* Derivatives of the states and outputs y at states x, inputs u and physical values of the parameters.
 *
 * zeta: in, values of Theta near which they are searched; out, those that were found; may be null.
 * Nothing is written unless 0 is returned; rates and y may be null pointers.
 */
int <<name>>_derivative(const double *values, const double *x, const double *u, double *zeta,
    double *rates, double *y);
<% endif %>

#ifdef __cplusplus
}
#endif

#endif
