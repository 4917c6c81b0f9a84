/* A recursion over samples, z <- step(z, arguments, constants), from the z given.
 *
 * Put before this: STATES, ARGUMENTS, CONSTANTS and step(in, out), in = [z, arguments, constants], out = next z.
 * arguments  (samples, ARGUMENTS)
 * states     (samples, STATES), out: z at each sample, before its step
 */
void recursion(long samples, double *z, const double *arguments, const double *constants, double *states)
{
    double in[STATES + ARGUMENTS + CONSTANTS];
    for (long k = 0; k < samples; k++) {
        for (int i = 0; i < STATES; i++) in[i] = states[k * STATES + i] = z[i];
        for (int i = 0; i < ARGUMENTS; i++) in[STATES + i] = arguments[k * ARGUMENTS + i];
        for (int i = 0; i < CONSTANTS; i++) in[STATES + ARGUMENTS + i] = constants[i];
        step(in, z);
    }
}
