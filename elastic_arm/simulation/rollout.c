/* Samples of a closed loop: fourth-order Runge-Kutta between them, the command held from one to the next.
 *
 * Put before this: DOF, STATES, JOINTS, CONSTANTS and accelerations(in, out),
 * in = [x, dx, z, tau_m, constants], out = [ddx, dz, tau_J].
 */
#include <string.h>

#define ODE (2 * DOF + STATES)
#define ALL (ODE + JOINTS)

/* Rate of y = [x, dx, z, integral of tau_J]; in holds tau_m and the constants already. */
static void rate(double *in, const double *y, double *k)
{
    double out[DOF + STATES + JOINTS];
    memcpy(in, y, ODE * sizeof(double));
    accelerations(in, out);
    memcpy(k, y + DOF, DOF * sizeof(double));
    memcpy(k + DOF, out, sizeof out);
}

static void advance(double *in, double *y, long steps, double h)
{
    double k1[ALL], k2[ALL], k3[ALL], k4[ALL], mid[ALL];
    for (long s = 0; s < steps; s++) {
        rate(in, y, k1);
        for (int i = 0; i < ODE; i++) mid[i] = y[i] + 0.5 * h * k1[i];
        rate(in, mid, k2);
        for (int i = 0; i < ODE; i++) mid[i] = y[i] + 0.5 * h * k2[i];
        rate(in, mid, k3);
        for (int i = 0; i < ODE; i++) mid[i] = y[i] + h * k3[i];
        rate(in, mid, k4);
        for (int i = 0; i < ALL; i++) y[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
    }
}

static double within(double value, double limit)
{
    return value > limit ? limit : value < -limit ? -limit : value;
}

/* Advance from sample to sample; returns how many were completed with finite numbers.
 *
 * commands   a sample, each held until the next
 * gains      kp, kd, ki, torque limit, dead band          5 JOINTS
 * reference  theta, dtheta, feed-forward torque           (samples commands, 3 JOINTS)
 * carry      y; over the last half interval the integral of tau_J and half the mean of tau_m; the command before; the
 *            integral of the error of theta               ODE + 4 JOINTS, in and out
 * out        y at the stamp, means of tau_J and tau_m over the interval centred on it, the command from it on
 */
long rollout(long samples, long half_steps, long commands, double period, const double *constants,
             const double *gains, const double *reference, double *carry, double *out)
{
    double in[ODE + JOINTS + CONSTANTS], y[ALL], held[JOINTS];
    double *half_J = carry + ODE, *half_m = half_J + JOINTS, *before = half_m + JOINTS, *integral = before + JOINTS;
    double *command = in + ODE;
    const double h = 0.5 * period / (double)half_steps;
    const int motor = DOF > JOINTS ? JOINTS : 0;
    const long parts = commands > 1 ? commands : 2, steps = 2 * half_steps / parts;
    memcpy(in + ODE + JOINTS, constants, CONSTANTS * sizeof(double));
    memcpy(y, carry, ODE * sizeof(double));
    for (long k = 0; k < samples; k++, out += ODE + 3 * JOINTS) {
        double *mean_J = out + ODE, *mean_m = mean_J + JOINTS;
        memcpy(out, y, ODE * sizeof(double));
        memset(y + ODE, 0, JOINTS * sizeof(double));
        memset(held, 0, sizeof held);
        for (long part = 0; part < parts; part++) {
            if (part * commands % parts == 0) {
                for (int i = 0; i < JOINTS; i++) {
                    const double error = reference[i] - y[motor + i], limit = gains[3 * JOINTS + i];
                    const double felt = error - within(error, gains[4 * JOINTS + i]);
                    const double torque = reference[2 * JOINTS + i] + gains[i] * felt
                                        + gains[JOINTS + i] * (reference[JOINTS + i] - y[DOF + motor + i])
                                        + gains[2 * JOINTS + i] * integral[i];
                    command[i] = within(torque, limit);
                    /* At its limit a drive does not wind up. */
                    if (command[i] == torque) integral[i] += error * period / (double)commands;
                }
                if (part == 0) memcpy(mean_m + JOINTS, command, JOINTS * sizeof(double));
                reference += 3 * JOINTS;
            }
            advance(in, y, steps, h);
            for (int i = 0; i < JOINTS; i++) held[i] += command[i] / (double)parts;
            if (2 * (part + 1) == parts) {
                for (int i = 0; i < JOINTS; i++) {
                    mean_J[i] = (half_J[i] + y[ODE + i]) / period;
                    mean_m[i] = half_m[i] + held[i];
                }
                memset(y + ODE, 0, JOINTS * sizeof(double));
                memset(held, 0, sizeof held);
            }
        }
        memcpy(half_J, y + ODE, JOINTS * sizeof(double));
        memcpy(half_m, held, sizeof held);
        memcpy(before, command, JOINTS * sizeof(double));
        for (int i = 0; i < ODE; i++)
            if (!isfinite(y[i])) return k;
        memcpy(carry, y, ODE * sizeof(double));
    }
    return samples;
}
