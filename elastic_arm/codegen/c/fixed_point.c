/* Fixed point: each column's samples are rounded to 51 bits below its largest one, and their products, 104 bits each,
   sum up in integers without any rounding. What is multiplied is not negative, x + 2^51, since the processor's
   instruction wants that:

     sum x y = sum (x + 2^51)(y + 2^51) - 2^51 sum (x + 2^51) - 2^51 sum (y + 2^51) + count 2^102.

   A column's unit holds until a sample exceeds its range, or until the sums could exceed 64 bits. */

#define TILE 24 /* blocks of eight samples at a time */
#define COLUMN_STEP (TILE + 1) /* a multiple of 4096 bytes would put all columns to the same lines of the cache */
#define BITS 52
#define OFFSET (1LL << (BITS - 1))
#define MOST_BLOCKS 1024               /* of 2^52 each, in 63 bits */
#define ROUNDING (1.5 * (1LL << BITS)) /* added to x, leaves x + 2^51 rounded in the lowest 52 bits */
#define ROUNDED_EXPONENT 0x4330000000000000LL
#define EXPONENT_BIAS 1023
#define LEAST_EXPONENT 64 /* of columns that are null, too */
#define NOT_FINITE 2047
#define LINES 5 /* cache lines of the next samples that are fetched while a column is multiplied by another */
#define AT_ONCE 2 /* columns times */
#define SIDE 4    /* others, whose products are summed in registers */

typedef struct { __m512i high, low; } wide;

long blocks(void) { return TILE; }
long column_step(void) { return COLUMN_STEP; }

/* Blocks in the sums of each row; of each column the exponent of its largest, and sum (x + 2^51); sums of products. Of
   the row at work, the tile in fixed point and its sums. */
typedef struct { long *blocks, *exponent; i8 *sum; wide *product; v8 *tile; i8 *tile_sum; } sums;

/* Where the parts of the state lie, and its size in bytes. */
static long parts_of(char *state, int rows, const int *row_first, sums *s) {
  const long columns = row_first[rows] + rows, most = longest(rows, row_first);
  char *at = state;
  long entries = 0;
  for (int r = 0; r < rows; r++) {
    const long count = row_first[r + 1] - row_first[r] + 1;
    entries += count * (count + 1) / 2;
  }
  s->tile = (v8 *)at, at += most * COLUMN_STEP * sizeof(v8);
  s->tile_sum = (i8 *)at, at += most * sizeof(i8);
  s->sum = (i8 *)at, at += columns * sizeof(i8);
  s->product = (wide *)at, at += entries * sizeof(wide);
  s->exponent = (long *)at, at += columns * sizeof(long);
  s->blocks = (long *)at, at += rows * sizeof(long);
  return at - state;
}

/* Bytes of the state, which is null at first. */
long state_size(int rows, const int *row_first) {
  sums s;
  return parts_of(NULL, rows, row_first, &s);
}

static inline double power_of_two(long exponent) {
  const long long bits = exponent << BITS;
  double x;
  memcpy(&x, &bits, sizeof x);
  return x;
}

/* Of the largest once it is rounded: the last two numbers below a power of two are rounded up to it. */
static inline long largest_exponent(const v8 *x) {
  const __m512i magnitude = _mm512_set1_epi64(0x7fffffffffffffffLL);
  __m512i even = _mm512_setzero_si512(), odd = even;
  for (int t = 0; t < TILE; t += 2) {
    even = _mm512_max_epi64(even, _mm512_and_si512((__m512i)x[t], magnitude));
    odd = _mm512_max_epi64(odd, _mm512_and_si512((__m512i)x[t + 1], magnitude));
  }
  const long largest = _mm512_reduce_max_epi64(_mm512_max_epi64(even, odd));
  const long most = largest >> BITS < NOT_FINITE ? (largest + 2) >> BITS : NOT_FINITE;
  return most > LEAST_EXPONENT ? most : LEAST_EXPONENT;
}

/* hi + lo += high + low, |high| of any size, low far smaller. */
static inline __attribute__((always_inline)) void add_pair(v8 high, v8 low, v8 *hi, v8 *lo) {
  const v8 next = *hi + high, part = next - *hi;
  *lo += ((*hi - (next - part)) + (high - part)) + low;
  *hi = next;
}

/* Add the integer sums of a row to hi + lo, and begin anew. */
static __attribute__((noinline)) void hand_over(int columns, long blocks, const long *exponent, i8 *sum, wide *product,
                                                v8 *hi, v8 *lo) {
  const i8 count = {blocks, blocks, blocks, blocks, blocks, blocks, blocks, blocks};
  double unit[columns];
  for (int c = 0; c < columns; c++) {
    unit[c] = exponent[c] == NOT_FINITE ? __builtin_nan("") : power_of_two(exponent[c] - (BITS - 2));
    sum[c] -= count * ROUNDED_EXPONENT;
  }
  for (int a = 0; a < columns; a++) {
    for (int b = 0; b <= a; b++, product++, hi++, lo++) {
      const i8 both = sum[a] + sum[b];
      i8 low = (i8)product->low - ((both & 1) << (BITS - 1));
      i8 high = (i8)product->high - (both >> 1) + count * (1LL << (BITS - 2)) + (low >> BITS);
      low &= (1LL << BITS) - 1;
      const v8 rounded = (v8)_mm512_cvtepi64_pd((__m512i)high);
      const i8 left = high - (i8)_mm512_cvtpd_epi64((__m512d)rounded);
      const v8 rest = (v8)_mm512_cvtepi64_pd((__m512i)left) * (double)(1LL << BITS) +
                      (v8)_mm512_cvtepi64_pd((__m512i)low);
      add_pair(rounded * (double)(1LL << BITS) * unit[a] * unit[b], rest * unit[a] * unit[b], hi, lo);
      product->high = product->low = _mm512_setzero_si512();
    }
  }
  memset(sum, 0, columns * sizeof *sum);
}

/* A column rounded to its unit, and its sum; whether it is out of range or not finite. */
static inline int to_fixed_point(const v8 *x, long exponent, v8 *to, i8 *sum) {
  const v8 scale = splat(power_of_two(2 * EXPONENT_BIAS + BITS - 2 - exponent)), rounding = splat(ROUNDING);
  i8 total = {0}, changed = {0};
  for (int t = 0; t < TILE; t++) {
    to[t] = x[t] * scale + rounding;
    total += (i8)to[t];
    changed |= (i8)to[t] ^ ROUNDED_EXPONENT;
  }
  *sum = total;
  return _mm512_test_epi64_mask((__m512i)changed, _mm512_set1_epi64(0xfffLL << BITS)) != 0;
}

/* product[k][c] += sum over a tile of x[k] * y[c]; of the last column, only with the last x, which it is. The numbers
   of columns are known to the compiler. The instruction takes the lowest 52 bits of each factor. */
static inline __attribute__((always_inline)) void add_products(const int factors, const int count, const int corner,
                                                               const v8 *x, const v8 *y, wide *const *product) {
  wide s[AT_ONCE][SIDE];
#pragma GCC unroll 8
  for (int k = 0; k < factors; k++)
#pragma GCC unroll 8
    for (int c = 0; c < count; c++)
      if (!corner || k == factors - 1 || c < count - 1) s[k][c] = product[k][c];
#pragma GCC unroll 2
  for (int t = 0; t < TILE; t++) {
#pragma GCC unroll 8
    for (int c = 0; c < count; c++) {
      const __m512i other = (__m512i)y[c * COLUMN_STEP + t];
#pragma GCC unroll 8
      for (int k = 0; k < factors; k++) {
        const __m512i factor = (__m512i)x[k * COLUMN_STEP + t];
        if (corner && k < factors - 1 && c == count - 1) continue;
        s[k][c].high = _mm512_madd52hi_epu64(s[k][c].high, factor, other);
        s[k][c].low = _mm512_madd52lo_epu64(s[k][c].low, factor, other);
      }
    }
  }
#pragma GCC unroll 8
  for (int k = 0; k < factors; k++)
#pragma GCC unroll 8
    for (int c = 0; c < count; c++)
      if (!corner || k == factors - 1 || c < count - 1) product[k][c] = s[k][c];
}

/* Products of one or two columns from a on with all up to them. */
static inline __attribute__((always_inline)) void add_columns(const int factors, const v8 *columns, int a,
                                                              wide *product) {
  const v8 *x = columns + (long)a * COLUMN_STEP, *y = columns;
  wide *at[AT_ONCE];
  for (int k = 0; k < factors; k++) at[k] = product + (long)(a + k) * (a + k + 1) / 2;
  int left = a + factors;
  for (; left > SIDE; left -= SIDE, y += SIDE * COLUMN_STEP) {
    add_products(factors, SIDE, 0, x, y, at);
    for (int k = 0; k < factors; k++) at[k] += SIDE;
  }
  if (left == 1) add_products(factors, 1, 1, x, y, at);
  if (left == 2) add_products(factors, 2, 1, x, y, at);
  if (left == 3) add_products(factors, 3, 1, x, y, at);
  if (left == 4) add_products(factors, 4, 1, x, y, at);
}

static inline const v8 *column(const v8 *values, const v8 *y, int c, int count) {
  return c < count ? values + (long)c * COLUMN_STEP : y;
}

/* Bring a row's tile to fixed point; where a column exceeds its unit or the sums would exceed their bits, begin anew. */
static void round_row(int count, const v8 *values, const v8 *y, sums *s, v8 *hi, v8 *lo) {
  int exceeded = *s->blocks == 0 || *s->blocks + TILE > MOST_BLOCKS;
  for (int c = 0; c <= count; c++)
    exceeded |= to_fixed_point(column(values, y, c, count), s->exponent[c], s->tile + c * COLUMN_STEP, s->tile_sum + c);
  if (exceeded) {
    if (*s->blocks) hand_over(count + 1, *s->blocks, s->exponent, s->sum, s->product, hi, lo);
    *s->blocks = 0;
    for (int c = 0; c <= count; c++) {
      const v8 *x = column(values, y, c, count);
      const long most = largest_exponent(x);
      if (most > s->exponent[c]) s->exponent[c] = most;
      to_fixed_point(x, s->exponent[c], s->tile + c * COLUMN_STEP, s->tile_sum + c);
    }
  }
  *s->blocks += TILE;
  for (int c = 0; c <= count; c++) s->sum[c] += s->tile_sum[c];
}

static long next_row(int columns, sums *s) {
  const long entries = (long)columns * (columns + 1) / 2;
  s->blocks++, s->exponent += columns, s->sum += columns, s->product += entries;
  return entries;
}

/* Lower triangle of [Phi_r, y_r]T [Phi_r, y_r] of each row r, packed row by row; a row's columns are its own values. */
void add_tile(int rows, const int *row_first, const v8 *values, const v8 *y, ahead *samples, void *state, v8 *hi,
              v8 *lo) {
  sums s;
  parts_of(state, rows, row_first, &s);
  for (int r = 0; r < rows; r++, y += COLUMN_STEP) {
    const int count = row_first[r + 1] - row_first[r];
    round_row(count, values, y, &s, hi, lo);
    int a = 0;
    for (; a + AT_ONCE <= count + 1; a += AT_ONCE) {
      fetch(&samples, (a + 1) * LINES);
      add_columns(AT_ONCE, s.tile, a, s.product);
    }
    if (a <= count) add_columns(1, s.tile, a, s.product);
    values += (long)count * COLUMN_STEP;
    const long entries = next_row(count + 1, &s);
    hi += entries, lo += entries;
  }
}

void finish(int rows, const int *row_first, void *state, v8 *hi, v8 *lo) {
  sums s;
  parts_of(state, rows, row_first, &s);
  for (int r = 0; r < rows; r++) {
    const int columns = row_first[r + 1] - row_first[r] + 1;
    if (*s.blocks) hand_over(columns, *s.blocks, s.exponent, s.sum, s.product, hi, lo);
    const long entries = next_row(columns, &s);
    hi += entries, lo += entries;
  }
}
