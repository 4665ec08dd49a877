// A register holds two vertices by (x, y, z, unused), or two columns of a matrix.
#include <immintrin.h>

#include "deform_kernel.h"

enum { AHEAD = 4096 }; // bytes of the stream that are asked for in advance

static inline const float *floats(const char *at) { return (const float *)(const void *)at; }
static inline const uint16_t *shorts(const char *at) { return (const uint16_t *)(const void *)at; }

// One 16-byte row of a table for each of two vertices.
static inline __m256 gather(const float *table, const uint16_t *joints, size_t k) {
    const __m256 first = _mm256_castps128_ps256(_mm_loadu_ps(&table[4 * (size_t)joints[k]]));
    return _mm256_insertf128_ps(first, _mm_loadu_ps(&table[4 * (size_t)joints[k + 4]]), 1);
}

static inline void store(char *output, __m128 value) {
    _mm_storel_pi((__m64 *)(void *)output, value);
    _mm_store_ss((float *)(void *)(output + 8), _mm_movehl_ps(value, value));
}

static inline void store_two(char *output, size_t stride, __m256 value) {
    const __m128 first = _mm256_castps256_ps128(value), second = _mm256_extractf128_ps(value, 1);
    if (stride == 12) {
        _mm_storeu_ps((float *)(void *)output, _mm_insert_ps(first, second, 0x30));
        _mm_storel_pi((__m64 *)(void *)(output + 16), _mm_permute_ps(second, 0x39));
        return;
    }
    store(output, first);
    store(output + stride, second);
}

// Four influences of two vertices more.
static inline __m256 add_set(__m256 sum, const float *weights, const uint16_t *joints,
                             const float *table) {
    const __m256 w = _mm256_load_ps(weights);
    sum = _mm256_add_ps(sum, _mm256_mul_ps(_mm256_permute_ps(w, 0x00), gather(table, joints, 0)));
    sum = _mm256_add_ps(sum, _mm256_mul_ps(_mm256_permute_ps(w, 0x55), gather(table, joints, 1)));
    sum = _mm256_add_ps(sum, _mm256_mul_ps(_mm256_permute_ps(w, 0xaa), gather(table, joints, 2)));
    return _mm256_add_ps(sum, _mm256_mul_ps(_mm256_permute_ps(w, 0xff), gather(table, joints, 3)));
}

static void positions(const pci_deform_rows *rows, const float *displacements, size_t begin,
                      size_t end, char *output, size_t stride) {
    const __m256i spread = _mm256_setr_epi32(0, 1, 2, 2, 3, 4, 5, 5);
    const pci_deform_span span = pci_deform_whole_blocks(begin, end);
    const size_t size = pci_deform_block_bytes(rows);
    const char *block = rows->blocks + span.first * size;
    char *out = output + PCI_DEFORM_BLOCK * span.first * stride;
    pci_deform_generic.positions(rows, displacements, begin, span.head, output, stride);
    for (size_t b = span.first; b < span.last; ++b, block += size) {
        for (size_t line = 0; line < size; line += 64) {
            _mm_prefetch(block + AHEAD + line, _MM_HINT_T0);
        }
        for (size_t pair = 0; pair < 8; ++pair, out += 2 * stride) {
            __m256 sum = _mm256_loadu_ps(floats(block) + 6 * pair);
            sum = _mm256_permutevar8x32_ps(sum, spread);
            const char *set = block + PCI_DEFORM_REST;
            do {
                sum = add_set(sum, floats(set) + 8 * pair,
                              shorts(set + PCI_DEFORM_WEIGHTS) + 8 * pair, displacements);
                set += PCI_DEFORM_SET_BYTES;
            } while (set < block + size);
            store_two(out, stride, sum);
        }
    }
    pci_deform_generic.positions(rows, displacements, span.tail, end, output, stride);
}

// sum w (R rest + t) of vertex i of a block.
static inline __m128 map_point(const char *block, size_t size, const float *maps, size_t i) {
    __m256 xy = _mm256_setzero_ps(), zt = _mm256_setzero_ps();
    for (const char *set = block + PCI_DEFORM_REST; set < block + size;
         set += PCI_DEFORM_SET_BYTES) {
        const float *weights = floats(set) + 4 * i;
        const uint16_t *joint = shorts(set + PCI_DEFORM_WEIGHTS) + 4 * i;
        for (size_t k = 0; k < PCI_DEFORM_SET; ++k) {
            const float *columns = &maps[16 * (size_t)joint[k]];
            const __m256 w = _mm256_set1_ps(weights[k]);
            xy = _mm256_add_ps(xy, _mm256_mul_ps(w, _mm256_load_ps(columns)));
            zt = _mm256_add_ps(zt, _mm256_mul_ps(w, _mm256_load_ps(columns + 8)));
        }
    }
    const float *p = floats(block) + 3 * i;
    xy = _mm256_mul_ps(xy, _mm256_set_m128(_mm_set1_ps(p[1]), _mm_set1_ps(p[0])));
    zt = _mm256_mul_ps(zt, _mm256_set_m128(_mm_set1_ps(1.0F), _mm_set1_ps(p[2])));
    return _mm_add_ps(_mm_add_ps(_mm256_castps256_ps128(xy), _mm256_extractf128_ps(xy, 1)),
                      _mm_add_ps(_mm256_castps256_ps128(zt), _mm256_extractf128_ps(zt, 1)));
}

static void affine(const pci_deform_rows *rows, const float *maps, size_t begin, size_t end,
                   char *output, size_t stride) {
    const pci_deform_span span = pci_deform_whole_blocks(begin, end);
    const size_t size = pci_deform_block_bytes(rows);
    pci_deform_generic.affine(rows, maps, begin, span.head, output, stride);
    for (size_t v = PCI_DEFORM_BLOCK * span.first; v < PCI_DEFORM_BLOCK * span.last; v += 2) {
        const char *block = rows->blocks + v / PCI_DEFORM_BLOCK * size;
        const size_t i = v % PCI_DEFORM_BLOCK;
        store_two(
            output + v * stride, stride,
            _mm256_set_m128(map_point(block, size, maps, i + 1), map_point(block, size, maps, i)));
    }
    pci_deform_generic.affine(rows, maps, span.tail, end, output, stride);
}

// sum w R rest of vertex i of a block.
static inline __m128 turn(const char *block, size_t size, const float *normals,
                          const float *rotations, size_t i) {
    __m256 xy = _mm256_setzero_ps();
    __m128 z = _mm_setzero_ps();
    for (const char *set = block + PCI_DEFORM_REST; set < block + size;
         set += PCI_DEFORM_SET_BYTES) {
        const float *weights = floats(set) + 4 * i;
        const uint16_t *joint = shorts(set + PCI_DEFORM_WEIGHTS) + 4 * i;
        for (size_t k = 0; k < PCI_DEFORM_SET; ++k) {
            const float *columns = &rotations[16 * (size_t)joint[k]];
            const __m256 w = _mm256_set1_ps(weights[k]);
            xy = _mm256_add_ps(xy, _mm256_mul_ps(w, _mm256_load_ps(columns)));
            z = _mm_add_ps(z, _mm_mul_ps(_mm256_castps256_ps128(w), _mm_load_ps(columns + 8)));
        }
    }
    const float *n = &normals[3 * i];
    const __m128 x = _mm_mul_ps(_mm256_castps256_ps128(xy), _mm_set1_ps(n[0]));
    const __m128 y = _mm_mul_ps(_mm256_extractf128_ps(xy, 1), _mm_set1_ps(n[1]));
    return _mm_add_ps(_mm_add_ps(x, y), _mm_mul_ps(z, _mm_set1_ps(n[2])));
}

static inline __m256 turn_two(const char *block, size_t size, const float *normals,
                              const float *rotations, size_t i) {
    return _mm256_insertf128_ps(_mm256_castps128_ps256(turn(block, size, normals, rotations, i)),
                                turn(block, size, normals, rotations, i + 1), 1);
}

// Squared length of each vertex, in all numbers of its lane.
static inline __m256 squares(__m256 n) {
    const __m256 s = _mm256_mul_ps(n, n);
    return _mm256_add_ps(_mm256_add_ps(_mm256_permute_ps(s, 0x00), _mm256_permute_ps(s, 0x55)),
                         _mm256_permute_ps(s, 0xaa));
}

static void normals(const pci_deform_rows *rows, const float *rotations, size_t begin, size_t end,
                    char *output, size_t stride) {
    const pci_deform_span span = pci_deform_whole_blocks(begin, end);
    const size_t size = pci_deform_block_bytes(rows);
    pci_deform_generic.normals(rows, rotations, begin, span.head, output, stride);
    for (size_t half = 2 * span.first; half < 2 * span.last; ++half) {
        const char *block = rows->blocks + half / 2 * size;
        const float *rest = floats(rows->normals + half / 2 * PCI_DEFORM_REST);
        const size_t first = 8 * (half % 2);
        const __m256 n0 = turn_two(block, size, rest, rotations, first);
        const __m256 n1 = turn_two(block, size, rest, rotations, first + 2);
        const __m256 n2 = turn_two(block, size, rest, rotations, first + 4);
        const __m256 n3 = turn_two(block, size, rest, rotations, first + 6);
        // One root and one division for eight vertices.
        __m256 square = _mm256_blend_ps(squares(n0), squares(n1), 0x22);
        square = _mm256_blend_ps(square, squares(n2), 0x44);
        square = _mm256_blend_ps(square, squares(n3), 0x88);
        const __m256 scale = _mm256_div_ps(_mm256_set1_ps(1.0F), _mm256_sqrt_ps(square));
        char *out = output + 8 * half * stride;
        store_two(out, stride, _mm256_mul_ps(n0, _mm256_permute_ps(scale, 0x00)));
        store_two(out + 2 * stride, stride, _mm256_mul_ps(n1, _mm256_permute_ps(scale, 0x55)));
        store_two(out + 4 * stride, stride, _mm256_mul_ps(n2, _mm256_permute_ps(scale, 0xaa)));
        store_two(out + 6 * stride, stride, _mm256_mul_ps(n3, _mm256_permute_ps(scale, 0xff)));
    }
    pci_deform_generic.normals(rows, rotations, span.tail, end, output, stride);
}

const pci_deform_kernel pci_deform_avx2 = {
    .positions = positions, .affine = affine, .normals = normals};
