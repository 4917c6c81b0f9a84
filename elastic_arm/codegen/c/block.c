/* Runs compute() over blocks of samples. What stands above this text is generated:
   N_INPUTS, N_OUTPUTS, N_VALUES, N_SHARED, MAX_SIZE, input_size[], input_shared[], output_size[], prepare(), compute(),
   spread[], which put an output's values to their places. */

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
    compute(rows, shared, values);
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
