/* Sums of products to some 77 bits of the columns' norms, eight lanes wide.

   A tile of each column is cut into a part of HIGH_BITS bits below its largest and the rest. Products of the high parts
   sum up without rounding, and those that hold a rest are 2^-25 times smaller: plain sums of both lose nothing that
   counts (S. M. Rump, T. Ogita, S. Oishi, Accurate floating-point summation, 2008: ExtractVector). Only the sum of a
   tile is added in twice the working precision. */

#define TILE 8       /* blocks of eight samples whose products are summed at a time */
#define HIGH_BITS 25 /* 2 HIGH_BITS + log2(TILE) <= 53 */
#define AT_ONCE 2    /* columns times */
#define SIDE 4       /* others, whose products are summed in registers */
#define LINES 1      /* cache lines of the next samples that are fetched while a column is multiplied by another */

typedef struct { v8 high[TILE], low[TILE], whole[TILE]; } parts;

long blocks(void) { return TILE; }
long column_step(void) { return TILE; }
long state_size(int rows, const int *row_first) { return longest(rows, row_first) * sizeof(parts); }
void finish(int rows, const int *row_first, void *state, v8 *hi, v8 *lo) {}

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
    to->whole[t] = x[t];
    to->high[t] = (x[t] + anchor) - anchor;
    to->low[t] = x[t] - to->high[t];
  }
}

/* hi[k][c] + lo[k][c] += sum over a tile of x[k] * y[c]; at the `corner`, where the last x are the last y, the lower
   triangle alone. The numbers of columns are known to the compiler. */
static inline __attribute__((always_inline)) void add_products(const int factors, const int count, const int corner,
                                                               const parts *x, const parts *y, v8 *const *hi,
                                                               v8 *const *lo) {
  v8 exact[AT_ONCE][SIDE], rest[AT_ONCE][SIDE];
#pragma GCC unroll 4
  for (int k = 0; k < factors; k++)
#pragma GCC unroll 4
    for (int c = 0; c < count; c++) exact[k][c] = rest[k][c] = splat(0.0);
#pragma GCC unroll 2
  for (int t = 0; t < TILE; t++) {
#pragma GCC unroll 4
    for (int c = 0; c < count; c++) {
      const v8 high = y[c].high[t], low = y[c].low[t];
#pragma GCC unroll 4
      for (int k = 0; k < factors; k++) {
        if (c >= count - corner * (factors - 1 - k)) continue;
        exact[k][c] += x[k].high[t] * high;
        rest[k][c] += x[k].low[t] * high;
        rest[k][c] += x[k].whole[t] * low;
      }
    }
  }
#pragma GCC unroll 4
  for (int k = 0; k < factors; k++)
#pragma GCC unroll 4
    for (int c = 0; c < count - corner * (factors - 1 - k); c++) {
      const v8 next = hi[k][c] + exact[k][c], part = next - hi[k][c];
      lo[k][c] += ((hi[k][c] - (next - part)) + (exact[k][c] - part)) + rest[k][c];
      hi[k][c] = next;
    }
}

/* Products of one or two columns from a on with all up to them. */
static inline __attribute__((always_inline)) void add_columns(const int factors, const parts *columns, int a, v8 *hi,
                                                              v8 *lo) {
  const parts *x = columns + a, *y = columns;
  v8 *hi_of[AT_ONCE], *lo_of[AT_ONCE];
#pragma GCC unroll 4
  for (int k = 0; k < factors; k++) hi_of[k] = hi, lo_of[k] = lo, hi += a + k + 1, lo += a + k + 1;
  int left = a + factors;
  for (; left > SIDE; left -= SIDE, y += SIDE) {
    add_products(factors, SIDE, 0, x, y, hi_of, lo_of);
#pragma GCC unroll 4
    for (int k = 0; k < factors; k++) hi_of[k] += SIDE, lo_of[k] += SIDE;
  }
  if (left == 1) add_products(factors, 1, 1, x, y, hi_of, lo_of);
  if (left == 2) add_products(factors, 2, 1, x, y, hi_of, lo_of);
  if (left == 3) add_products(factors, 3, 1, x, y, hi_of, lo_of);
  if (left == 4) add_products(factors, 4, 1, x, y, hi_of, lo_of);
}

/* Lower triangle of [Phi_r, y_r]T [Phi_r, y_r] of each row r, packed row by row; a row's columns are its own values.
   `state` has room for the parts of the longest row; `samples` are those that come next. */
void add_tile(int rows, const int *row_first, const v8 *values, const v8 *y, ahead *samples, void *state, v8 *hi,
              v8 *lo) {
  parts *work = state;
  for (int r = 0; r < rows; r++) {
    const int count = row_first[r + 1] - row_first[r];
    const v8 *own = values + (long)row_first[r] * TILE;
    for (int a = 0; a < count; a++) cut(own + a * TILE, work + a);
    cut(y + r * TILE, work + count);
    for (int a = 0; a <= count; a += AT_ONCE) {
      fetch(&samples, (a + 1) * LINES);
      if (a < count) add_columns(2, work, a, hi, lo);
      else add_columns(1, work, a, hi, lo);
      const int entries = a < count ? 2 * a + 3 : a + 1;
      hi += entries, lo += entries;
    }
  }
}
