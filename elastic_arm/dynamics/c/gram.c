/* Sums of products in twice the working precision (T. Ogita, S. M. Rump, S. Oishi, Accurate sum and dot product, 2005:
   Dot2), eight lanes wide. Compiled without contraction: a fused s = hi + x * y would undo the error terms. */

#define TILE 8

static inline v8 fused(v8 x, v8 y, v8 z) {
  v8 r;
  for (int l = 0; l < LANES; l++) r[l] = __builtin_fma(x[l], y[l], z[l]);
  return r;
}

/* hi + lo += sum over a tile of x * y. */
static inline void add_products(const v8 *x, const v8 *y, v8 *hi, v8 *lo) {
  v8 sum = *hi, rest = *lo;
  for (int t = 0; t < TILE; t++) {
    v8 product = x[t] * y[t];
    v8 product_error = fused(x[t], y[t], -product);
    v8 next = sum + product;
    v8 part = next - sum;
    rest += ((sum - (next - part)) + (product - part)) + product_error;
    sum = next;
  }
  *hi = sum;
  *lo = rest;
}

/* Lower triangle of [Phi_r, y_r]T [Phi_r, y_r] of each row r, packed row by row; a row's columns are its own values. */
void add_rows(int rows, const int *row_first, const int *row_value, const v8 *values, const v8 *y, double *hi,
              double *lo) {
  v8 *h = (v8 *)hi, *l = (v8 *)lo;
  for (int r = 0; r < rows; r++) {
    int count = row_first[r + 1] - row_first[r];
    const int *own = row_value + row_first[r];
    for (int a = 0; a <= count; a++) {
      const v8 *x = a < count ? values + (long)own[a] * TILE : y + r * TILE;
      for (int b = 0; b < a; b++) add_products(x, values + (long)own[b] * TILE, h++, l++);
      add_products(x, x, h++, l++);
    }
  }
}
