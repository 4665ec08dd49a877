// Left-looking supernodal Cholesky: CXSparse orders (AMD) and analyses, the numbers are ours.
// CXSparse's own up-looking factorisation needs 2 to 3 times as long on surface Laplacians, because
// it handles single entries; here columns with (nearly) the same rows form dense blocks.
#include "solvers/sparse.h"

#include <limits.h>
#include <stdlib.h>

#define NCOMPLEX
#include <cs.h>

// Block b holds the columns first[b] .. first[b + 1] - 1 of L, all with the rows
// rows[row_offsets[b]] ..., the block's own columns first, as a column-major dense matrix.
struct pci_cholesky {
    pci_scratch memory;
    size_t size;
    uint32_t *order; // column k belongs to unknown order[k]
    size_t block_count;
    uint32_t *first;
    size_t *row_offsets;
    uint32_t *rows; // ascending per block
    size_t *value_offsets;
    double *values;
};

// What the factorisation needs besides the result.
typedef struct workspace {
    cs_di *lower; // permuted matrix, lower triangle by columns
    int *parent;  // elimination tree
    int *counts;  // entries per column of L
    uint32_t *block_of;
    uint32_t *next; // lists of blocks, by block
    uint32_t *head;
    uint32_t *place; // of a row in the current block
} workspace;

#define TILE 4 // rows and columns of the register tile

// ---- analysis -----------------------------------------------------------------------------------

static cs_di *permuted_upper(const cs_di *matrix, const int *order, int values) {
    int *inverse = cs_di_pinv(order, matrix->n);
    cs_di *upper = inverse != NULL ? cs_di_symperm(matrix, inverse, values) : NULL;
    cs_di_free(inverse);
    return upper;
}

// Fill-reducing order whose elimination tree is postordered, so that blocks are neighbours.
static bool find_order(const cs_di *matrix, int *order) {
    const int n = matrix->n;
    int *amd = cs_di_amd(1, matrix);
    cs_di *upper = amd != NULL ? permuted_upper(matrix, amd, 0) : NULL;
    int *parent = upper != NULL ? cs_di_etree(upper, 0) : NULL;
    int *post = parent != NULL ? cs_di_post(parent, n) : NULL;
    for (int k = 0; post != NULL && k < n; ++k) {
        order[k] = amd[post[k]];
    }
    const bool done = post != NULL;
    cs_di_free(post);
    cs_di_free(parent);
    cs_di_spfree(upper);
    cs_di_free(amd);
    return done;
}

static bool analyse(const cs_di *matrix, const int *order, workspace *work) {
    cs_di *upper = permuted_upper(matrix, order, 1);
    if (upper != NULL) {
        work->parent = cs_di_etree(upper, 0);
        int *post = work->parent != NULL ? cs_di_post(work->parent, matrix->n) : NULL;
        work->counts = post != NULL ? cs_di_counts(upper, work->parent, post, 0) : NULL;
        work->lower = cs_di_transpose(upper, 1);
        cs_di_free(post);
    }
    cs_di_spfree(upper);
    return work->counts != NULL && work->lower != NULL;
}

// Whether joining two blocks pays: few stored zeros, more of them while the block is narrow.
static bool worth_joining(size_t width, size_t rows, size_t zeros) {
    const double entries = (double)(width * rows) - 0.5 * (double)(width * (width - 1));
    const double share = width <= 4 ? 0.8 : width <= 16 ? 0.35 : width <= 48 ? 0.1 : 0.05;
    return (double)zeros <= share * entries;
}

// Splits the columns into blocks. A column joins its predecessor when it has the same rows; then
// blocks join their parent in the elimination tree where that adds few zeros.
static void find_blocks(pci_cholesky *c, const workspace *work, size_t *block_rows,
                        size_t *block_zeros) {
    size_t count = 0;
    for (size_t j = 0; j < c->size;) {
        size_t end = j + 1;
        while (end < c->size && work->parent[end - 1] == (int)end &&
               work->counts[end - 1] == work->counts[end] + 1) {
            ++end;
        }
        size_t rows = (size_t)work->counts[j], zeros = 0, begin = j;
        while (count > 0) {
            const int up = work->parent[begin - 1];
            if (up < (int)begin || up >= (int)end) {
                break;
            }
            const size_t previous = c->first[count - 1], width = begin - previous;
            const size_t joined_zeros =
                zeros + block_zeros[count - 1] + width * (width + rows - block_rows[count - 1]);
            if (!worth_joining(end - previous, width + rows, joined_zeros)) {
                break;
            }
            zeros = joined_zeros, rows += width, begin = previous;
            --count;
        }
        c->first[count] = (uint32_t)begin;
        block_rows[count] = rows;
        block_zeros[count] = zeros;
        c->first[++count] = (uint32_t)end;
        j = end;
    }
    c->block_count = count;
}

static int compare_u32(const void *a, const void *b) {
    const uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

// Rows of a block: those of its matrix columns and of its children in the tree of blocks.
static void find_rows(pci_cholesky *c, workspace *work) {
    for (size_t b = 0; b < c->block_count; ++b) {
        work->head[b] = PC_INVALID_INDEX;
    }
    for (size_t b = 0; b < c->block_count; ++b) {
        const uint32_t begin = c->first[b], end = c->first[b + 1];
        const uint32_t mark = (uint32_t)b + 1; // place[row] == mark: already listed
        uint32_t *rows = &c->rows[c->row_offsets[b]];
        size_t count = 0;
        for (uint32_t j = begin; j < end; ++j) {
            rows[count++] = j;
            work->place[j] = mark;
        }
        for (int p = work->lower->p[begin]; p < work->lower->p[end]; ++p) {
            const uint32_t row = (uint32_t)work->lower->i[p];
            if (work->place[row] != mark) {
                work->place[row] = mark;
                rows[count++] = row;
            }
        }
        for (uint32_t d = work->head[b]; d != PC_INVALID_INDEX; d = work->next[d]) {
            for (size_t r = c->row_offsets[d] + (c->first[d + 1] - c->first[d]);
                 r < c->row_offsets[d + 1]; ++r) {
                if (work->place[c->rows[r]] != mark) {
                    work->place[c->rows[r]] = mark;
                    rows[count++] = c->rows[r];
                }
            }
        }
        qsort(rows, count, sizeof(*rows), compare_u32);
        c->row_offsets[b + 1] = c->row_offsets[b] + count;
        c->value_offsets[b + 1] = c->value_offsets[b] + count * (end - begin);
        if (count > end - begin) {
            const uint32_t up = work->block_of[rows[end - begin]];
            work->next[b] = work->head[up];
            work->head[up] = (uint32_t)b;
        }
    }
}

// ---- numbers ------------------------------------------------------------------------------------

// sum[j][i] = sum over k < depth of left[i + stride k] right[j + stride k]. May read, and then
// ignores, rows behind the last one of a block: values[] has room for it.
static inline void multiply_tile(const double *left, const double *right, size_t stride,
                                 size_t depth, double sum[TILE][TILE]) {
    double s[TILE][TILE] = {{0.0}};
    for (size_t k = 0; k < depth; ++k, left += stride, right += stride) {
        for (size_t j = 0; j < TILE; ++j) {
            for (size_t i = 0; i < TILE; ++i) {
                s[j][i] += left[i] * right[j];
            }
        }
    }
    memcpy(sum, s, sizeof(s));
}

// Subtracts from block b what block d, a descendant, contributes: its rows [from, to) are columns
// of b.
static void apply_descendant(const pci_cholesky *c, const uint32_t *place, size_t b, size_t d,
                             size_t from, size_t to) {
    const uint32_t *rows = &c->rows[c->row_offsets[d]];
    const size_t height = c->row_offsets[d + 1] - c->row_offsets[d];
    const size_t width = c->first[d + 1] - c->first[d];
    const size_t target_height = c->row_offsets[b + 1] - c->row_offsets[b];
    const double *source = &c->values[c->value_offsets[d]];
    double *target = &c->values[c->value_offsets[b]];
    double sum[TILE][TILE];
    for (size_t j = from; j < to; j += TILE) {
        const size_t columns = to - j < TILE ? to - j : TILE;
        for (size_t i = j; i < height; i += TILE) {
            const size_t count = height - i < TILE ? height - i : TILE;
            multiply_tile(source + i, source + j, height, width, sum);
            for (size_t q = 0; q < columns; ++q) {
                double *column = target + (rows[j + q] - c->first[b]) * target_height;
                for (size_t p = 0; p < count; ++p) {
                    column[place[rows[i + p]]] -= sum[q][p];
                }
            }
        }
    }
}

// Dense Cholesky of a block in panels of TILE columns. False: a pivot is not positive.
static bool factorise_block(double *block, size_t height, size_t width) {
    double sum[TILE][TILE];
    for (size_t panel = 0; panel < width; panel += TILE) {
        const size_t end = width - panel < TILE ? width : panel + TILE;
        for (size_t i = panel; i < height; i += TILE) {
            const size_t count = height - i < TILE ? height - i : TILE;
            multiply_tile(block + i, block + panel, height, panel, sum);
            for (size_t q = panel; q < end; ++q) {
                for (size_t p = 0; p < count; ++p) {
                    block[q * height + i + p] -= sum[q - panel][p];
                }
            }
        }
        for (size_t k = panel; k < end; ++k) {
            double *column = block + k * height;
            if (!(column[k] > 0.0) || !isfinite(column[k])) {
                return false;
            }
            const double pivot = sqrt(column[k]);
            column[k] = pivot;
            for (size_t i = k + 1; i < height; ++i) {
                column[i] /= pivot;
            }
            for (size_t q = k + 1; q < end; ++q) {
                const double factor = column[q];
                for (size_t i = q; i < height; ++i) {
                    block[q * height + i] -= factor * column[i];
                }
            }
        }
    }
    return true;
}

// Visits the blocks in order. A factorised block waits in the list of the block that owns the first
// of its rows that has not been used yet.
static bool factorise(pci_cholesky *c, workspace *work, size_t *used) {
    for (size_t b = 0; b < c->block_count; ++b) {
        work->head[b] = PC_INVALID_INDEX;
    }
    for (size_t b = 0; b < c->block_count; ++b) {
        const uint32_t begin = c->first[b], end = c->first[b + 1];
        const uint32_t *rows = &c->rows[c->row_offsets[b]];
        const size_t height = c->row_offsets[b + 1] - c->row_offsets[b];
        double *block = &c->values[c->value_offsets[b]];
        for (size_t r = 0; r < height; ++r) {
            work->place[rows[r]] = (uint32_t)r;
        }
        for (uint32_t j = begin; j < end; ++j) {
            for (int p = work->lower->p[j]; p < work->lower->p[j + 1]; ++p) {
                block[(j - begin) * height + work->place[work->lower->i[p]]] = work->lower->x[p];
            }
        }
        for (uint32_t d = work->head[b], after; d != PC_INVALID_INDEX; d = after) {
            after = work->next[d];
            const uint32_t *others = &c->rows[c->row_offsets[d]];
            const size_t other_height = c->row_offsets[d + 1] - c->row_offsets[d];
            size_t to = used[d];
            while (to < other_height && others[to] < end) {
                ++to;
            }
            apply_descendant(c, work->place, b, d, used[d], to);
            used[d] = to;
            if (to < other_height) {
                const uint32_t up = work->block_of[others[to]];
                work->next[d] = work->head[up];
                work->head[up] = d;
            }
        }
        if (!factorise_block(block, height, end - begin)) {
            return false;
        }
        used[b] = end - begin;
        if (used[b] < height) {
            const uint32_t up = work->block_of[rows[used[b]]];
            work->next[b] = work->head[up];
            work->head[up] = (uint32_t)b;
        }
    }
    return true;
}

// ---- interface ----------------------------------------------------------------------------------

static pc_status build(pc_context *context, const char *stage, const cs_di *matrix,
                       pci_scratch *scratch, workspace *work, pci_cholesky *c) {
    const size_t n = c->size;
    int *order = PCI_SCRATCH(scratch, int, n);
    work->block_of = PCI_SCRATCH(scratch, uint32_t, n);
    work->next = PCI_SCRATCH(scratch, uint32_t, n);
    work->head = PCI_SCRATCH(scratch, uint32_t, n);
    work->place = PCI_SCRATCH(scratch, uint32_t, n);
    size_t *block_rows = PCI_SCRATCH(scratch, size_t, n);
    size_t *block_zeros = PCI_SCRATCH(scratch, size_t, n);
    c->order = PCI_SCRATCH(&c->memory, uint32_t, n);
    c->first = PCI_SCRATCH(&c->memory, uint32_t, n + 1);
    if (scratch->failed || c->memory.failed || !find_order(matrix, order) ||
        !analyse(matrix, order, work)) {
        return pci_fail_memory(context, stage);
    }
    for (size_t k = 0; k < n; ++k) {
        c->order[k] = (uint32_t)order[k];
    }
    find_blocks(c, work, block_rows, block_zeros);
    size_t row_count = 0;
    for (size_t b = 0; b < c->block_count; ++b) {
        row_count += block_rows[b];
        for (uint32_t j = c->first[b]; j < c->first[b + 1]; ++j) {
            work->block_of[j] = (uint32_t)b;
        }
    }
    c->row_offsets = PCI_SCRATCH(&c->memory, size_t, c->block_count + 1);
    c->value_offsets = PCI_SCRATCH(&c->memory, size_t, c->block_count + 1);
    c->rows = PCI_SCRATCH(&c->memory, uint32_t, row_count);
    if (c->memory.failed) {
        return pci_fail_memory(context, stage);
    }
    find_rows(c, work);
    // multiply_tile may read up to TILE - 1 values behind the last block.
    c->values = PCI_SCRATCH(&c->memory, double, c->value_offsets[c->block_count] + TILE);
    if (c->memory.failed) {
        return pci_fail_memory(context, stage);
    }
    if (!factorise(c, work, block_rows)) {
        return pci_fail(context, PC_ERROR_NUMERICAL, stage,
                        "%s: a linear system is not positive definite", stage);
    }
    return PC_OK;
}

pc_status pci_cholesky_create(pc_context *context, const char *stage, size_t size,
                              const size_t *column_offsets, const uint32_t *rows,
                              const double *values, pci_cholesky **cholesky) {
    *cholesky = NULL;
    if (size >= INT_MAX || column_offsets[size] >= INT_MAX) {
        return pci_fail(context, PC_ERROR_TOO_LARGE, stage,
                        "%s: a linear system has %zu unknowns and %zu entries, the limit is %d",
                        stage, size, column_offsets[size], INT_MAX);
    }
    pci_scratch scratch = pci_scratch_begin(context);
    workspace work = {0};
    pc_status status = PC_OK;
    pci_cholesky *c = PCI_ALLOCATE(context, pci_cholesky, 1);
    int *offsets = PCI_SCRATCH(&scratch, int, size + 1);
    int *indices = PCI_SCRATCH(&scratch, int, column_offsets[size]);
    double *entries = PCI_SCRATCH(&scratch, double, column_offsets[size]);
    if (c == NULL || scratch.failed) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    c->memory = pci_scratch_begin(context);
    c->size = size;
    for (size_t j = 0; j <= size; ++j) {
        offsets[j] = (int)column_offsets[j];
    }
    for (size_t p = 0; p < column_offsets[size]; ++p) {
        indices[p] = (int)rows[p];
        entries[p] = values[p];
    }
    const cs_di matrix = {.nzmax = offsets[size],
                          .m = (int)size,
                          .n = (int)size,
                          .p = offsets,
                          .i = indices,
                          .x = entries,
                          .nz = -1};
    status = size > 0 ? build(context, stage, &matrix, &scratch, &work, c) : PC_OK;
    if (status == PC_OK) {
        *cholesky = c;
        c = NULL;
    }
cleanup:
    cs_di_spfree(work.lower);
    cs_di_free(work.parent);
    cs_di_free(work.counts);
    pci_scratch_end(&scratch);
    pci_cholesky_destroy(context, c);
    return status;
}

void pci_cholesky_destroy(pc_context *context, pci_cholesky *cholesky) {
    if (cholesky != NULL) {
        pci_scratch_end(&cholesky->memory);
        pc_release(context, cholesky);
    }
}

enum {
    TOGETHER = PCI_CHOLESKY_TOGETHER,
    LANES = 4
}; // right-hand sides that share a pass over the factor; registers

// L y = x, block by block; x is row-major, #size by `count` right-hand sides, a number that is
// known where this is compiled. Blocks whose part of x is 0 have nothing to say.
static inline __attribute__((always_inline)) void solve_lower(const pci_cholesky *c,
                                                              const size_t count, double *x) {
    for (size_t b = 0; b < c->block_count; ++b) {
        const uint32_t *rows = &c->rows[c->row_offsets[b]];
        const size_t height = c->row_offsets[b + 1] - c->row_offsets[b];
        const size_t width = c->first[b + 1] - c->first[b];
        const double *block = &c->values[c->value_offsets[b]];
        double *own = &x[c->first[b] * count];
        bool empty = true;
        for (size_t i = 0; i < width * count && empty; ++i) {
            empty = own[i] == 0.0;
        }
        for (size_t i = 0; i < height && !empty; ++i) {
            double *to = &x[rows[i] * count], sum[TOGETHER];
            memcpy(sum, to, count * sizeof(*sum));
            for (size_t k = 0; k < width && k < i; ++k) {
                for (size_t q = 0; q < count; ++q) {
                    sum[q] -= block[k * height + i] * own[k * count + q];
                }
            }
            for (size_t q = 0; q < count && i < width; ++q) {
                sum[q] /= block[i * height + i];
            }
            memcpy(to, sum, count * sizeof(*sum));
        }
    }
}

// Dot products of the part of a column from row `begin` on with some of `count` right-hand sides,
// in interleaved sums that fit into registers.
static inline __attribute__((always_inline)) void
dot_column(const double *column, const uint32_t *rows, size_t begin, size_t end, const size_t count,
           const size_t taken, const double *x, double *dot) {
    enum { SUMS = 4 };
    double sum[SUMS][LANES] = {{0.0}};
    size_t i = begin;
    for (; i + SUMS <= end; i += SUMS) {
        for (size_t s = 0; s < SUMS; ++s) {
            for (size_t q = 0; q < taken; ++q) {
                sum[s][q] += column[i + s] * x[rows[i + s] * count + q];
            }
        }
    }
    for (; i < end; ++i) {
        for (size_t q = 0; q < taken; ++q) {
            sum[0][q] += column[i] * x[rows[i] * count + q];
        }
    }
    for (size_t q = 0; q < taken; ++q) {
        dot[q] = (sum[0][q] + sum[1][q]) + (sum[2][q] + sum[3][q]);
    }
}

// L^T x = y likewise.
static inline __attribute__((always_inline)) void solve_upper(const pci_cholesky *c,
                                                              const size_t count, double *x) {
    for (size_t b = c->block_count; b-- > 0;) {
        const uint32_t *rows = &c->rows[c->row_offsets[b]];
        const size_t height = c->row_offsets[b + 1] - c->row_offsets[b];
        for (size_t k = c->first[b + 1] - c->first[b]; k-- > 0;) {
            const double *column = &c->values[c->value_offsets[b] + k * height];
            double dot[TOGETHER], *to = &x[rows[k] * count];
            size_t q = 0;
            for (; q + LANES <= count; q += LANES) {
                dot_column(column, rows, k + 1, height, count, LANES, &x[q], &dot[q]);
            }
            if (q < count) {
                dot_column(column, rows, k + 1, height, count, count - q, &x[q], &dot[q]);
            }
            for (q = 0; q < count; ++q) {
                to[q] = (to[q] - dot[q]) / column[k];
            }
        }
    }
}

const uint32_t *pci_cholesky_order(const pci_cholesky *cholesky) { return cholesky->order; }

void pci_cholesky_solve_ordered(const pci_cholesky *cholesky, double *x) {
    solve_lower(cholesky, TOGETHER, x);
    solve_upper(cholesky, TOGETHER, x);
}

typedef struct solve_job {
    const pci_cholesky *cholesky;
    size_t columns;
    const double *b; // #size by columns
    double *x;       // likewise
    double *ordered; // #size by the right-hand sides of a piece, piece by piece
} solve_job;

static void solve_columns(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const solve_job *job = user;
    const pci_cholesky *c = job->cholesky;
    const size_t count = end - begin;
    double *x = &job->ordered[c->size * begin];
    for (size_t k = 0; k < c->size; ++k) {
        memcpy(&x[k * count], &job->b[c->order[k] * job->columns + begin], count * sizeof(*x));
    }
    if (count == TOGETHER) {
        pci_cholesky_solve_ordered(c, x);
    } else {
        solve_lower(c, count, x);
        solve_upper(c, count, x);
    }
    for (size_t k = 0; k < c->size; ++k) {
        memcpy(&job->x[c->order[k] * job->columns + begin], &x[k * count], count * sizeof(*x));
    }
}

pc_status pci_cholesky_solve(pc_context *context, const pci_cholesky *cholesky, size_t columns,
                             const double *b, double *x) {
    pci_scratch scratch = pci_scratch_begin(context);
    double *ordered = PCI_SCRATCH(&scratch, double, cholesky->size *columns);
    if (scratch.failed) {
        pci_scratch_end(&scratch);
        return pci_fail_memory(context, "sparse");
    }
    solve_job job = {.cholesky = cholesky, .columns = columns, .b = b, .x = x, .ordered = ordered};
    pci_parallel_for(context, columns, TOGETHER, solve_columns, &job);
    pci_scratch_end(&scratch);
    return PC_OK;
}
