/* Triangular factors of matrices hi + lo: the operations of double_double.py one by one, to the same last bit. */

#include <math.h>

typedef struct { double hi, lo; } pair;

static inline pair renormalised(double hi, double lo) {
  const double total = hi + lo;
  return (pair){total, lo - (total - hi)};
}

static inline pair add(pair a, pair b) {
  const double total = a.hi + b.hi, part = total - a.hi;
  return renormalised(total, (a.hi - (total - part)) + (b.hi - part) + (a.lo + b.lo));
}

static inline pair multiply(pair a, pair b) {
  const double product = a.hi * b.hi;
  return renormalised(product, fma(a.hi, b.hi, -product) + (a.hi * b.lo + a.lo * b.hi));
}

static inline pair divide(pair a, pair b) {
  const double first = a.hi / b.hi, product = first * b.hi;
  const double rest = (a.hi - product) - fma(first, b.hi, -product) + a.lo - first * b.lo;
  return renormalised(first, rest / b.hi);
}

/* row += share * from, to its end. */
static void add_multiple(int columns, pair share, const double *restrict from_hi, const double *restrict from_lo,
                         double *restrict hi, double *restrict lo) {
  for (int c = 0; c < columns; c++) {
    const pair next = add((pair){hi[c], lo[c]}, multiply(share, (pair){from_hi[c], from_lo[c]}));
    hi[c] = next.hi, lo[c] = next.lo;
  }
}

/* Of each matrix (k, k), whose upper triangle is used up, to R (k, k) of zeros. */
void cholesky(long matrices, int k, double nothing, double *hi, double *lo, double *R) {
  for (; matrices > 0; matrices--, hi += (long)k * k, lo += (long)k * k, R += (long)k * k) {
    double size[k];
    for (int i = 0; i < k; i++) size[i] = hi[(long)i * k + i];
    for (int i = 0; i < k; i++) {
      const long row = (long)i * k;
      const double real = hi[row + i] > nothing * size[i];
      const pair pivot = {real ? hi[row + i] : 1.0, real ? lo[row + i] : 0.0};
      for (int c = i; c < k; c++) R[row + c] = hi[row + c] * (real / sqrt(pivot.hi));
      for (int c = i + 1; c < k; c++) hi[row + c] *= real, lo[row + c] *= real;
      for (int r = i + 1; r < k; r++) {
        const pair share = divide((pair){hi[row + r], lo[row + r]}, pivot);
        const long to = (long)r * k + r;
        add_multiple(k - r, (pair){-share.hi, -share.lo}, hi + row + r, lo + row + r, hi + to, lo + to);
      }
    }
  }
}
