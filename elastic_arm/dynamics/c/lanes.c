/* Eight samples side by side. GCC's and clang's vector extensions: any width of the machine serves. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#define LANES 8
typedef double v8 __attribute__((vector_size(64), aligned(64)));

#ifdef VECTOR_MATH /* the GNU C library's vector variants, within 4 units in the last place */
__attribute__((simd("notinbranch"), const)) double sin(double);
__attribute__((simd("notinbranch"), const)) double cos(double);
__attribute__((simd("notinbranch"), const)) double exp(double);
__attribute__((simd("notinbranch"), const)) double log(double);
#endif

static inline v8 splat(double x) { return (v8){x, x, x, x, x, x, x, x}; }

#define LANEWISE(name, expression)                         \
  static inline v8 lane_##name(v8 x) {                     \
    v8 r;                                                  \
    for (int l = 0; l < LANES; l++) r[l] = expression;     \
    return r;                                              \
  }
#define LANEWISE2(name, expression)                        \
  static inline v8 lane_##name(v8 x, v8 y) {               \
    v8 r;                                                  \
    for (int l = 0; l < LANES; l++) r[l] = expression;     \
    return r;                                              \
  }
