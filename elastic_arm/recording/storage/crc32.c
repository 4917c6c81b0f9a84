/* The CRC-32 of zlib by carry-less multiplication: V. Gopal and others, Fast CRC Computation for Generic Polynomials
 * Using PCLMULQDQ Instruction, Intel, 2009. */
#ifndef __PCLMUL__
#error "the processor has no carry-less multiplication"
#endif
#include <wmmintrin.h>

/* x moved on by the distance of the two powers in k: x^(d + 32) and x^(d - 32) modulo the polynomial, bits reversed. */
static __m128i moved(__m128i x, __m128i k)
{
    return _mm_xor_si128(_mm_clmulepi64_si128(x, k, 0x00), _mm_clmulepi64_si128(x, k, 0x11));
}

/* Fold `blocks` of 64 bytes, at least one, to the 16 bytes that leave the same remainder after a register of zeros. */
void fold(const char *data, long blocks, char *left)
{
    const __m128i by_64 = _mm_set_epi64x(0x01c6e41596, 0x0154442bd4);
    const __m128i by_16 = _mm_set_epi64x(0x00ccaa009e, 0x01751997d0);
    __m128i x[4];
    for (int k = 0; k < 4; k++)
        x[k] = _mm_loadu_si128((const __m128i *)data + k);
    x[0] = _mm_xor_si128(x[0], _mm_cvtsi32_si128(-1)); /* the register begins with ones */
    while (--blocks) {
        data += 64;
        for (int k = 0; k < 4; k++)
            x[k] = _mm_xor_si128(moved(x[k], by_64), _mm_loadu_si128((const __m128i *)data + k));
    }
    for (int k = 1; k < 4; k++)
        x[k] = _mm_xor_si128(moved(x[k - 1], by_16), x[k]);
    _mm_storeu_si128((__m128i *)left, x[3]);
}
