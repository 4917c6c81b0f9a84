/* What block.c, which computes values, and gram.c and fixed_point.c, which sum their products, have in common. */

typedef long long i8 __attribute__((vector_size(64), aligned(64)));

/* Samples that are summed next: an address and a number of cache lines; a null ends the list. */
typedef struct { const char *next; long lines; } ahead;

/* Sums tiles of `blocks` times eight samples, column c of a tile from c * column_step on; see gram.c. */
typedef struct {
  long (*blocks)(void);
  long (*column_step)(void);
  long (*state_size)(int rows, const int *row_first);
  void (*add_tile)(int rows, const int *row_first, const v8 *values, const v8 *y, ahead *samples, void *state, v8 *hi,
                   v8 *lo);
  void (*finish)(int rows, const int *row_first, void *state, v8 *hi, v8 *lo);
} accumulator;

/* Bring samples to the cache while products are summed: that leaves the memory idle, and lasts longer than the
   processor looks ahead by itself. */
static inline void fetch(ahead **samples, long lines) {
  for (; lines > 0 && (*samples)->next; lines--) {
    if ((*samples)->lines-- > 0) __builtin_prefetch((*samples)->next, 0, 2), (*samples)->next += 64;
    else ++*samples;
  }
}

/* Columns of the longest row, y included. */
static inline long longest(int rows, const int *row_first) {
  int most = 0;
  for (int r = 0; r < rows; r++) most = row_first[r + 1] - row_first[r] > most ? row_first[r + 1] - row_first[r] : most;
  return most + 1;
}
