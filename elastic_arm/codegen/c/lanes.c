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

typedef double v4 __attribute__((vector_size(32), aligned(32)));
typedef double v4_anywhere __attribute__((vector_size(32), aligned(8)));

/* Store lane l of a, b, c, d to to[l * step .. l * step + 3]. */
static inline void store_lanes(v4 a, v4 b, v4 c, v4 d, double *to, long step) {
#if defined(__clang__) || __GNUC__ >= 12
  v4 e = __builtin_shufflevector(a, b, 0, 4, 2, 6), f = __builtin_shufflevector(a, b, 1, 5, 3, 7);
  v4 g = __builtin_shufflevector(c, d, 0, 4, 2, 6), h = __builtin_shufflevector(c, d, 1, 5, 3, 7);
  *(v4_anywhere *)to = __builtin_shufflevector(e, g, 0, 1, 4, 5);
  *(v4_anywhere *)(to + step) = __builtin_shufflevector(f, h, 0, 1, 4, 5);
  *(v4_anywhere *)(to + 2 * step) = __builtin_shufflevector(e, g, 2, 3, 6, 7);
  *(v4_anywhere *)(to + 3 * step) = __builtin_shufflevector(f, h, 2, 3, 6, 7);
#else
  for (int l = 0; l < 4; l++) *(v4_anywhere *)(to + l * step) = (v4){a[l], b[l], c[l], d[l]};
#endif
}
