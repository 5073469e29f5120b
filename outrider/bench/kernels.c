/* The kernels of sim/models/field.py as a C programmer would write them: what `outrider bench` measures ours against.
 *
 * Strict floating point: -O3 -march=native -ffp-contract=off, no -ffast-math. With lanes != 0 sums go through a row buffer and
 * eight running sums, as ours do, and the results are ours to the bit; with lanes == 0 there is one running sum. */
#include <math.h>
#include <stdlib.h>

enum { HILL = 0, PLATEAU = 1 };

static inline double sensor_quality(int sensor, double rho2, double peak, double reach) {
    double s = rho2 / (reach * reach);
    if (sensor == PLATEAU) s = s * s;
    double rest = s < 1.0 ? 1.0 - s : 0.0;
    return peak * rest * rest;
}

static inline double sensor_slope(int sensor, double rho2, double peak, double reach) {
    double scale = 1.0 / (reach * reach), s = rho2 * scale;
    if (sensor == PLATEAU) return -4.0 * peak * scale * s * (s < 1.0 ? 1.0 - s * s : 0.0);
    return -2.0 * peak * scale * (s < 1.0 ? 1.0 - s : 0.0);
}

static inline double density(double rho2, double r_o) {
    double s = rho2 / (r_o * r_o), rest = s < 1.0 ? 1.0 - s : 0.0;
    double g = -1.1866978791794382e-07;
    g = g * s + 4.015015824839582e-06;
    g = g * s - 9.641667903338588e-05;
    g = g * s + 1.7326615035514177e-03;
    g = g * s - 2.2245115569201e-02;
    g = g * s + 1.8910772506711293e-01;
    g = g * s - 9.34802200532295e-01;
    g = g * s + 1.9999999999999032;
    return rest * rest * g;
}

static inline double penalty(double lack) { return lack > 0.0 ? lack * lack : 0.0; }
static inline double penalty_slope(double lack) { return lack > 0.0 ? 2.0 * lack : 0.0; }
static inline double half_chord(double radius, double offset) { return sqrt(fmax(0.0, radius * radius - offset * offset)); }

static inline void chord(double center, double half, double cell, long count, long *first, long *end) {
    long a = (long)ceil((center - half) / cell - 0.5), b = (long)floor((center + half) / cell - 0.5) + 1;
    *first = a > 0 ? a : 0;
    *end = b < count ? b : count;
}

static double lane_sum(const double *terms, long count) {
    double lane[8] = {0.0}, rest = 0.0;
    long whole = count - count % 8;
    for (long i = 0; i < whole; i += 8)
        for (int k = 0; k < 8; k++) lane[k] += terms[i + k];
    for (long i = whole; i < count; i++) rest += terms[i];
    return (((lane[0] + lane[4]) + (lane[2] + lane[6])) + ((lane[1] + lane[5]) + (lane[3] + lane[7]))) + rest;
}

void accumulate(double *coverage, long rows, long columns, double p_x, double p_y, int sensor, double peak, double reach,
                double cell, double duration) {
    long first_row, end_row, first, end;
    chord(p_y, reach, cell, rows, &first_row, &end_row);
    for (long j = first_row; j < end_row; j++) {
        double d_y = (j + 0.5) * cell - p_y, *cells = coverage + j * columns;
        chord(p_x, half_chord(reach, d_y), cell, columns, &first, &end);
        for (long i = first; i < end; i++) {
            double d_x = (i + 0.5) * cell - p_x;
            cells[i] += sensor_quality(sensor, d_x * d_x + d_y * d_y, peak, reach) * duration;
        }
    }
}

double coverage_error(int lanes, const double *coverage, long rows, long columns, double p_gx, double p_gy, double r_o,
                      double desired, double cell) {
    long first_row, end_row, first, end;
    double total = 0.0, *terms = malloc(columns * sizeof *terms);
    chord(p_gy, r_o, cell, rows, &first_row, &end_row);
    for (long j = first_row; j < end_row; j++) {
        double d_y = (j + 0.5) * cell - p_gy;
        const double *cells = coverage + j * columns;
        chord(p_gx, half_chord(r_o, d_y), cell, columns, &first, &end);
        if (lanes) {
            for (long i = first; i < end; i++) {
                double d_x = (i + 0.5) * cell - p_gx;
                terms[i - first] = penalty(desired - cells[i]) * density(d_x * d_x + d_y * d_y, r_o);
            }
            total += lane_sum(terms, end > first ? end - first : 0);
        } else {
            for (long i = first; i < end; i++) {
                double d_x = (i + 0.5) * cell - p_gx;
                total += penalty(desired - cells[i]) * density(d_x * d_x + d_y * d_y, r_o);
            }
        }
    }
    free(terms);
    return total * (cell * cell);
}

void coverage_gradient(int lanes, const double *coverage, long rows, long columns, double p_ax, double p_ay, double p_gx,
                       double p_gy, double r_o, double desired, int sensor, double peak, double reach, double cell,
                       double *out) {
    long first_row, end_row, first, end;
    double sum_x = 0.0, sum_y = 0.0, size = 0.0;
    double *weights = malloc(2 * columns * sizeof *weights), *pulls = weights + columns;
    chord(p_ay, reach, cell, rows, &first_row, &end_row);
    for (long j = first_row; j < end_row; j++) {
        double y = (j + 0.5) * cell, d_y = p_ay - y, g_y = p_gy - y, row_weight = 0.0;
        const double *cells = coverage + j * columns;
        chord(p_ax, half_chord(reach, d_y), cell, columns, &first, &end);
        if (lanes) {
            for (long i = first; i < end; i++) {
                double x = (i + 0.5) * cell, d_x = p_ax - x, g_x = p_gx - x;
                double slope = 2.0 * sensor_slope(sensor, d_x * d_x + d_y * d_y, peak, reach);
                double weight = penalty_slope(desired - cells[i]) * slope * density(g_x * g_x + g_y * g_y, r_o);
                weights[i - first] = weight;
                pulls[i - first] = weight * d_x;
            }
            row_weight = lane_sum(weights, end > first ? end - first : 0);
            sum_x += lane_sum(pulls, end > first ? end - first : 0);
        } else {
            for (long i = first; i < end; i++) {
                double x = (i + 0.5) * cell, d_x = p_ax - x, g_x = p_gx - x;
                double slope = 2.0 * sensor_slope(sensor, d_x * d_x + d_y * d_y, peak, reach);
                double weight = penalty_slope(desired - cells[i]) * slope * density(g_x * g_x + g_y * g_y, r_o);
                row_weight += weight;
                sum_x += weight * d_x;
            }
        }
        sum_y += row_weight * d_y;
        size += fabs(row_weight) * reach;
    }
    free(weights);
    out[0] = sum_x * (cell * cell);
    out[1] = sum_y * (cell * cell);
    out[2] = size * (cell * cell);
}

/* The three kernels again and again, as the compiled loop in outrider/bench/kernels.py has them. */
double passes(int lanes, double *coverage, long rows, long columns, long count) {
    double total = 0.0, found[3];
    for (long k = 0; k < count; k++) {
        double x = 20.0 + 1e-4 * k;
        accumulate(coverage, rows, columns, x, 20.0, HILL, 1.0, 5.0, 0.25, 0.0);
        total += coverage_error(lanes, coverage, rows, columns, x, 21.0, 9.75, 2.0, 0.25);
        coverage_gradient(lanes, coverage, rows, columns, x, 20.0, x, 21.0, 9.75, 2.0, HILL, 1.0, 5.0, 0.25, found);
        total += found[0];
    }
    return total;
}
