/* The published braking run with a PI as a plain C loop: the arithmetic of railslip_ctrl/simulation/kernel.py for a
   run without distance events, sensor imperfections or log. */

#include <math.h>

static long nodes;

static double tabulated(double x, const double *table) {
    double place = fabs(x) * table[0];
    long i = (long)place < nodes - 2 ? (long)place : nodes - 2;
    double u = place - i, f0 = table[1 + 2 * i], d0 = table[2 + 2 * i], f1 = table[3 + 2 * i], d1 = table[4 + 2 * i];
    double rise = f1 - f0, value = f0 + u * (d0 + u * (3.0 * rise - 2.0 * d0 - d1 + u * (d0 + d1 - 2.0 * rise)));
    return x >= 0.0 ? value : -value;
}

/* [Park2008] (3) and (4) with the force of the curve: v', sigma', z', and the powers that each torque or force takes.
   p: M, J, B, r, Fr0, Fr1, Fr2, N, alpha, beta, gamma, R, v0. */
static void rates_and_powers(double v, double sigma, double torque, double disturbance, double random_torque,
                             const double *p, const double *table, double *out) {
    double force = tabulated(sigma / v, table), resistance = p[4] + v * (p[5] + v * p[6]);
    double r = p[3], omega = (v - sigma) / r;
    out[0] = -(force + resistance + random_torque / r) / p[0];
    out[1] = out[0] + r / p[1] * (torque + disturbance + p[2] * omega - random_torque - r * force);
    out[2] = 0.0;
    out[3] = torque * omega;
    out[4] = force * sigma;
    out[5] = p[2] * omega * omega;
    out[6] = resistance * v;
    out[7] = random_torque / r * sigma;
    out[8] = disturbance * omega;
}

/* d sigma'/d sigma, with the curve's slope by its differential equation. */
static double stiffness(double v, double sigma, const double *p, const double *table) {
    double slip = fabs(sigma) / v, force = fabs(tabulated(sigma / v, table));
    double slope = p[8] * slip * p[12] * p[12] / (p[11] * v) * (1.0 - p[9] * force / (p[10] - slip * p[12]));
    return -p[2] / p[1] - (p[3] * p[3] / p[1] + 1.0 / p[0]) * slope;
}

enum { V, SIGMA, Z, TORQUE, DISTANCE, WORK, STATES = 11 };

typedef struct {
    double period, step, dead_time, lag_time, viscous, viscous_rate;
    double fraction, decay, frequency, hold, final_speed, longest_time, top_speed;
    double event_time, event_mass;
    double kp, ki, reference_dry, reference_wet, torque_min;
} Settings;

typedef struct {
    double time, slip_error, highest_slip, locked_time, highest_torque, rate_squared, highest_rate, booked;
    long steps;
} Summary;

static double disturbance(double t, double torque, const Settings *a) {
    double decay = a->decay * t;
    if (decay > 50.0) return 0.0;
    return a->fraction * torque * exp(-decay) * sin(a->frequency * t);
}

static void derivative(double t, const double *y, double *p, const double *table, const Settings *a, int locked,
                       double delayed, double random_torque, double *out) {
    double values[9];
    p[2] = a->viscous + a->viscous_rate * t;
    rates_and_powers(y[V], y[SIGMA], y[TORQUE], disturbance(t, y[TORQUE], a), random_torque, p, table, values);
    out[V] = values[0];
    out[SIGMA] = locked ? values[0] : values[1];
    out[Z] = values[2];
    out[TORQUE] = (delayed - y[TORQUE]) / a->lag_time;
    out[DISTANCE] = y[V];
    for (int i = 0; i < STATES - WORK; i++) out[WORK + i] = values[3 + i];
}

static void advance(double t, const double *y, double h, double *p, const double *table, const Settings *a, int locked,
                    double delayed, double random_torque, double k[4][STATES], double *new) {
    derivative(t, y, p, table, a, locked, delayed, random_torque, k[0]);
    for (int i = 0; i < STATES; i++) new[i] = y[i] + 0.5 * h * k[0][i];
    derivative(t + 0.5 * h, new, p, table, a, locked, delayed, random_torque, k[1]);
    for (int i = 0; i < STATES; i++) new[i] = y[i] + 0.5 * h * k[1][i];
    derivative(t + 0.5 * h, new, p, table, a, locked, delayed, random_torque, k[2]);
    for (int i = 0; i < STATES; i++) new[i] = y[i] + h * k[2][i];
    derivative(t + h, new, p, table, a, locked, delayed, random_torque, k[3]);
    for (int i = 0; i < STATES; i++) new[i] = y[i] + h / 6.0 * (k[0][i] + 2.0 * k[1][i] + 2.0 * k[2][i] + k[3][i]);
}

static int happened(const double *y, const Settings *a) {
    return (y[V] <= a->final_speed ? 1 : 0) | (y[SIGMA] >= y[V] ? 2 : 0);
}

static double fastest(const double *y, const double *p, const double *table, const Settings *a) {
    return fmax(fabs(stiffness(y[V], y[SIGMA], p, table)), 1.0 / a->lag_time);
}

static double energy(const double *y, const double *p) {
    double omega = (y[V] - y[SIGMA]) / p[3];
    return 0.5 * p[0] * y[V] * y[V] + 0.5 * p[1] * omega * omega;
}

static void account(const double *y, const double *new, double h, double k[4][STATES], double reference, Summary *sum) {
    double slip = y[SIGMA] / y[V], after = new[SIGMA] / new[V], rate = (new[TORQUE] - y[TORQUE]) / h;
    sum->slip_error += 0.5 * h * (fabs(slip - reference) + fabs(after - reference));
    sum->highest_slip = fmax(sum->highest_slip, after);
    sum->locked_time += 0.5 * h * ((slip > 0.98) + (after > 0.98));
    sum->highest_torque = fmax(sum->highest_torque, new[TORQUE]);
    sum->rate_squared += h * rate * rate;
    sum->highest_rate = fmax(sum->highest_rate, fabs(k[0][TORQUE]));
    sum->steps++;
}

static double domain_limit(double v, const double *limits, const Settings *a) {
    double place = fmin(fmax(v / a->top_speed * 64, 0.0), 64.0);
    int i = place < 63.0 ? (int)place : 63;
    return limits[i] + (place - i) * (limits[i + 1] - limits[i]);
}

/* Returns 0 for a stop, 1 out of time, 2 outside the domain, 3 locked (which this loop does not go beyond). */
int run(const Settings *a, const double *forces, double *p, const double *tables, long table_size,
        const double *limits, double *y, Summary *sum) {
    double history[1024] = {0}, k[4][STATES], new[STATES], integral = 0.0, reference = a->reference_dry;
    const double *table = tables;
    nodes = (table_size - 1) / 2;
    long delay = (long)floor(a->dead_time / a->period + 1e-9), size = delay + 2;
    double rest = a->dead_time - delay * a->period, tiny = 1e-9 * a->period;
    long samples = (long)ceil(a->longest_time / a->period - 1e-9);
    int fired = 0;
    if (rest < 1e-9 * a->period) rest = 0.0;
    for (long sample = 0; sample < samples; sample++) {
        double t = sample * a->period, end = (sample + 1) * a->period, change = sample * a->period + rest;
        if (!fired && a->event_time <= t + tiny) {
            double before = energy(y, p);
            fired = 1;
            p[0] = a->event_mass, p[9] *= 2.0;
            table = tables + table_size, limits += 65, reference = a->reference_wet;
            sum->booked += energy(y, p) - before;
        }
        double wheel = (y[V] - y[SIGMA]) / p[3], error = reference * y[V] - (y[V] - p[3] * wheel);
        integral += a->ki * a->period * error;
        history[sample % size] = fmax(a->kp * error + integral, a->torque_min);
        while (t < end - tiny) {
            double until = end;
            if (t < change - tiny) until = fmin(until, change);
            double following = (floor(t / a->hold + 1e-9) + 1.0) * a->hold;
            if (following < until - tiny) until = following;
            if (!fired && a->event_time < until - tiny) until = a->event_time;
            long known = sample - delay - (t < change - tiny ? 1 : 0);
            double delayed = known >= 0 ? history[known % size] : 0.0; /* nothing was asked for before */
            double random_torque = p[3] * forces[(long)(t / a->hold + 1e-9)];
            double span = until - t, rate = fmax(1.0 / a->step, fastest(y, p, table, a) / 0.5);
            double count = fmax(ceil(span * rate - 1e-6), 1.0), h = span / count;
            for (long n = 0; n < (long)count; n++) {
                double now = t + n * h, share = 1.0;
                advance(now, y, h, p, table, a, 0, delayed, random_torque, k, new);
                int what = happened(new, a);
                if (what) {
                    double low = 0.0;
                    for (int i = 0; i < 52; i++) {
                        double middle = 0.5 * (low + share);
                        advance(now, y, middle * h, p, table, a, 0, delayed, random_torque, k, new);
                        if (happened(new, a)) share = middle; else low = middle;
                    }
                    advance(now, y, share * h, p, table, a, 0, delayed, random_torque, k, new);
                    what = happened(new, a);
                }
                account(y, new, share * h, k, reference, sum);
                for (int i = 0; i < STATES; i++) y[i] = new[i];
                sum->time = now + share * h;
                if (!(isfinite(y[V]) && isfinite(y[SIGMA])) || fabs(y[SIGMA]) >= domain_limit(y[V], limits, a)) return 2;
                if (what) return what & 1 ? 0 : 3;
            }
            t = until;
        }
    }
    return 1;
}
