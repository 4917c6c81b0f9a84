/* Runs compute() over blocks of samples. What stands above this text is generated:
   N_INPUTS, N_OUTPUTS, N_VALUES, N_SHARED, MAX_SIZE, input_size[], input_shared[], output_size[], prepare(), compute(),
   spread[], which put an output's values to their places; of the first output, for the information matrices: ROWS,
   row_first[], after which a row's values follow one another. */

/* Past the caches, without reading the lines first; `to` is 16-byte aligned, as all memory of the C library is. */
static inline void stream(double *to, const double *from, long count) {
#if defined(__AVX512F__)
  for (; (size_t)to % 64 == 0 && count >= 8; count -= 8, to += 8, from += 8)
    _mm512_stream_pd(to, _mm512_load_pd(from));
#endif
#if defined(__x86_64__)
  for (long k = 0; k < count; k += 2) _mm_stream_pd(to + k, _mm_load_pd(from + k));
#else
  memcpy(to, from, count * sizeof(double));
#endif
}

/* Point `rows` at eight samples from `start`; past the end, at copies in `pad` whose missing lanes repeat the last. */
static long point(long start, long n, const double *const *in, const double **rows, double *pad) {
  long valid = n - start < LANES ? n - start : LANES;
  for (int i = 0; i < N_INPUTS; i++) {
    long size = input_size[i];
    if (input_shared[i]) continue;
    rows[i] = in[i] + start * size;
    if (valid == LANES) continue;
    double *copy = pad + (long)i * LANES * MAX_SIZE;
    for (int l = 0; l < LANES; l++) memcpy(copy + l * size, rows[i] + (l < valid ? l : valid - 1) * size, size * 8);
    rows[i] = copy;
  }
  return valid;
}

long prepared_size(void) { return N_SHARED; }

void prepare_shared(const double *const *in, double *shared) { prepare(in, shared); }

enum way { COPY, PAST_CACHES, ONTO_ZEROS };

/* Dense outputs, sample by sample. 0 on success, 1 when memory is short. */
int dense(long n, const double *const *in, const double *shared, double *const *out, enum way way) {
  const double *rows[N_INPUTS + 1];
  double *pad = malloc(sizeof(double) * (N_INPUTS + 1) * LANES * MAX_SIZE);
  double *block[N_OUTPUTS];
  v8 values[N_VALUES + 1];
  int failed = pad == NULL;
  for (int o = 0; o < N_OUTPUTS; o++) {
    size_t bytes = output_size[o] * LANES * sizeof(double);
    block[o] = aligned_alloc(64, (bytes + 63) / 64 * 64);
    if (block[o] == NULL) failed = 1;
    else memset(block[o], 0, bytes);
  }
  for (long start = 0; !failed && start < n; start += LANES) {
    long valid = point(start, n, in, rows, pad);
    compute(rows, shared, values, 1);
    for (int o = 0; o < N_OUTPUTS; o++) {
      long size = output_size[o];
      int direct = way == ONTO_ZEROS && valid == LANES;
      spread[o]((const double *)values, direct ? out[o] + start * size : block[o]);
      if (direct) continue;
      if (way == PAST_CACHES && valid == LANES) stream(out[o] + start * size, block[o], size * LANES);
      else memcpy(out[o] + start * size, block[o], valid * size * sizeof(double));
    }
  }
#if defined(__x86_64__)
  if (way == PAST_CACHES) _mm_sfence();
#endif
  for (int o = 0; o < N_OUTPUTS; o++) free(block[o]);
  free(pad);
  return failed;
}

/* Values and measured y (n, ROWS) of eight samples from `start`, every step-th; zeros where there are none. */
static void fill(long start, long n, const double *const *in, const double *shared, const double *y, double *pad,
                 v8 *values, v8 *measured, long step) {
  const double *rows[N_INPUTS + 1];
  long valid = start < n ? point(start, n, in, rows, pad) : 0;
  if (valid) compute(rows, shared, values, step);
  for (int r = 0; valid == LANES && r < ROWS; r++)
    for (int l = 0; l < LANES; l++) measured[r * step][l] = y[(start + l) * ROWS + r];
  for (int r = 0; valid < LANES && r < ROWS; r++)
    for (int l = 0; l < LANES; l++) measured[r * step][l] = l < valid ? y[(start + l) * ROWS + r] : 0.0;
  for (int k = 0; valid < LANES && k < N_VALUES; k++)
    for (int l = valid; l < LANES; l++) values[k * step][l] = 0.0;
}

/* Point `to` at the blocks from sample `from` on, as far as they are whole. */
static void look_ahead(long from, long n, long blocks, const double *const *in, const double *y, ahead *to) {
  const long left = (n - from) / LANES, count = left < 0 ? 0 : left < blocks ? left : blocks;
  for (int i = 0; i < N_INPUTS; i++)
    if (!input_shared[i]) *to++ = (ahead){(const char *)(in[i] + from * input_size[i]), count * input_size[i]};
  *to++ = (ahead){(const char *)(y + from * ROWS), count * ROWS};
  *to = (ahead){NULL, 0};
}

/* Information of the first output's rows with the measured y, summed by `sum` into hi and lo. */
int information(long n, const double *const *in, const double *shared, const double *y, const accumulator *sum, v8 *hi,
                v8 *lo) {
  const long blocks = sum->blocks(), step = sum->column_step(), tile = blocks * LANES;
  const long state_size = (sum->state_size(ROWS, row_first) + sizeof(v8) - 1) / sizeof(v8) * sizeof(v8);
  double *pad = malloc(sizeof(double) * (N_INPUTS + 1) * LANES * MAX_SIZE);
  v8 *values = aligned_alloc(sizeof(v8), sizeof(v8) * step * (N_VALUES + ROWS)), *measured = values + step * N_VALUES;
  void *state = aligned_alloc(sizeof(v8), state_size);
  const int failed = pad == NULL || values == NULL || state == NULL;
  ahead next[N_INPUTS + 2];
  if (!failed) memset(state, 0, state_size);
  for (long start = 0; !failed && start < n; start += tile) {
    for (long t = 0; t < blocks; t++) fill(start + t * LANES, n, in, shared, y, pad, values + t, measured + t, step);
    look_ahead(start + tile, n, blocks, in, y, next);
    sum->add_tile(ROWS, row_first, values, measured, next, state, hi, lo);
  }
  if (!failed) sum->finish(ROWS, row_first, state, hi, lo);
  free(pad);
  free(values);
  free(state);
  return failed;
}
