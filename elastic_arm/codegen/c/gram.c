/* Sums of products to some 77 bits of the columns' norms, eight lanes wide.

   A tile of each column is cut into a part of HIGH_BITS bits below its largest and the rest. Products of the high parts
   sum up without rounding, and those that hold a rest are 2^-25 times smaller: plain sums of both lose nothing that
   counts (S. M. Rump, T. Ogita, S. Oishi, Accurate floating-point summation, 2008: ExtractVector). Only the sum of a
   tile is added in twice the working precision. */

#define TILE 8
#define HIGH_BITS 25 /* 2 HIGH_BITS + log2(TILE) <= 53 */
#define SIDE 4       /* columns whose products with another one are summed in registers */

typedef long long i8 __attribute__((vector_size(64), aligned(64)));
typedef struct { v8 high[TILE], low[TILE]; } parts;

static inline v8 larger(v8 most, v8 x) {
  v8 r;
  for (int l = 0; l < LANES; l++) r[l] = most[l] > __builtin_fabs(x[l]) ? most[l] : __builtin_fabs(x[l]);
  return r;
}

/* Adding what has no bits below the unit rounds to that unit. */
static inline void cut(const v8 *x, parts *to) {
  v8 even = splat(0.0), odd = even;
  for (int t = 0; t < TILE; t += 2) even = larger(even, x[t]), odd = larger(odd, x[t + 1]);
  const i8 exponent = (i8)larger(even, odd) & 0x7ff0000000000000LL;
  const v8 anchor = (v8)exponent * (1.5 * (1LL << (53 - HIGH_BITS)));
  for (int t = 0; t < TILE; t++) {
    to->high[t] = (x[t] + anchor) - anchor;
    to->low[t] = x[t] - to->high[t];
  }
}

/* hi[c] + lo[c] += sum over a tile of x * y[c]; `count` is known to the compiler. */
static inline __attribute__((always_inline)) void add_products(const int count, const v8 *x, const parts *cut_x,
                                                               const parts *cut_y, v8 *hi, v8 *lo) {
  v8 exact[SIDE], rest[SIDE];
#pragma GCC unroll 4
  for (int c = 0; c < count; c++) exact[c] = rest[c] = splat(0.0);
#pragma GCC unroll 2
  for (int t = 0; t < TILE; t++) {
    const v8 whole = x[t], high = cut_x->high[t], low = cut_x->low[t];
#pragma GCC unroll 4
    for (int c = 0; c < count; c++) {
      exact[c] += high * cut_y[c].high[t];
      rest[c] += low * cut_y[c].high[t];
      rest[c] += whole * cut_y[c].low[t];
    }
  }
#pragma GCC unroll 4
  for (int c = 0; c < count; c++) {
    const v8 next = hi[c] + exact[c], part = next - hi[c];
    lo[c] += ((hi[c] - (next - part)) + (exact[c] - part)) + rest[c];
    hi[c] = next;
  }
}

/* Lower triangle of [Phi_r, y_r]T [Phi_r, y_r] of each row r, packed row by row; a row's columns are its own values.
   `work` holds as many parts as the longest row has columns, y included. */
void add_rows(int rows, const int *row_first, const v8 *values, const v8 *y, parts *work, v8 *hi, v8 *lo) {
  for (int r = 0; r < rows; r++) {
    const int count = row_first[r + 1] - row_first[r];
    const v8 *own = values + (long)row_first[r] * TILE;
    for (int a = 0; a < count; a++) cut(own + a * TILE, work + a);
    cut(y + r * TILE, work + count);
    for (int a = 0; a <= count; a++) {
      const v8 *x = a < count ? own + a * TILE : y + r * TILE;
      int b = 0;
      for (; b + SIDE <= a + 1; b += SIDE, hi += SIDE, lo += SIDE) add_products(SIDE, x, work + a, work + b, hi, lo);
      const int left = a + 1 - b;
      if (left == 1) add_products(1, x, work + a, work + b, hi, lo);
      if (left == 2) add_products(2, x, work + a, work + b, hi, lo);
      if (left == 3) add_products(3, x, work + a, work + b, hi, lo);
      hi += left;
      lo += left;
    }
  }
}
