#include "stages/skin/skin_gram.h"

enum { SAMPLE_BLOCKS = PCI_SKIN_LOADED, FRAMES_AT_ONCE = 4 };
enum { TABLE_FRAMES = SAMPLE_BLOCKS * PCI_BLOCK, TABLE_ROWS = 3 * TABLE_FRAMES };

typedef struct gram_job {
    const double *rows; // #rows by size
    size_t count, size; // size: of the matrix
    double *matrix;
} gram_job;

// Adds the products of some rows to the lower triangle.
static void add_products(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const gram_job *job = user;
    const size_t size = job->size;
    for (size_t t = 0; t < job->count; ++t) {
        const double *d = &job->rows[t * size];
        for (size_t b = begin; b < end; ++b) {
            double *row = &job->matrix[b * size];
            for (size_t c = 0; c < end; ++c) {
                row[c] += d[b] * d[c];
            }
        }
    }
}

// Writes the three rows of A of all bones in one frame, in the unit of the kernels, the mean
// displacement left out as there.
static void fill_rows(const pci_skin_frames *w, size_t frame, double *rows) {
    const pci_skin_problem *p = w->problem;
    const size_t columns = w->data.columns, size = p->proxy_count * columns;
    double map[3 * PCI_SKIN_COLUMNS_MAX] = {0}, mean[3] = {0};
    for (size_t b = 0; b < p->proxy_count; ++b) {
        pci_skin_bone_map(p, w->origin, frame, b, map);
        for (size_t c = 0; c < 3; ++c) {
            double *row = &rows[c * size + b * columns];
            row[0] = w->unit * map[c];
            mean[c] += row[0] / (double)p->proxy_count;
            for (size_t k = 1; k < columns; ++k) {
                row[k] = map[3 * k + c];
            }
        }
    }
    for (size_t c = 0; c < 3; ++c) {
        for (size_t b = 0; b < p->proxy_count; ++b) {
            rows[c * size + b * columns] -= mean[c];
        }
    }
}

// Mean square of how far the displacements of two vertices that an edge of the proxy joins are
// apart.
static double deformation(const pci_skin_gram *gram) {
    const pci_skin_frames *w = &gram->driver;
    const pci_skin_problem *p = w->problem;
    const pc_mesh *proxy = gram->proxy;
    const size_t edges = 3 * proxy->triangle_count;
    double sum = 0.0;
    for (size_t k = 0; k < edges; ++k) {
        const size_t bones[2] = {proxy->triangles[k], proxy->triangles[k % 3 == 2 ? k - 2 : k + 1]};
        double points[2][PCI_SKIN_COLUMNS_MAX] = {{1.0}, {1.0}};
        for (size_t c = 0; c < 6; ++c) {
            const double place = p->proxy_rest[3 * bones[c / 3] + c % 3];
            points[c / 3][1 + c % 3] = w->unit * (place - w->origin[c % 3]);
        }
        for (size_t c = 0; c < 4; ++c) {
            const double product = pci_skin_gram_sample(gram, w->data.columns, bones[c / 2],
                                                        bones[c % 2], points[c / 2], points[c % 2]);
            sum += c / 2 == c % 2 ? product : -product;
        }
    }
    return edges > 0 && sum > 0.0 ? sum / (double)edges : 0.0;
}

static void find_noise(pci_skin_gram *gram) {
    gram->noise = 0.0;
    gram->noise = gram->noise_share > 0.0 ? gram->noise_share * deformation(gram) : 0.0;
}

// Adds the noise: each bone shifts by as much as a share of how far neighbours move apart.
static void add_noise(pci_skin_gram *gram) {
    const size_t columns = gram->driver.data.columns;
    const size_t size = gram->driver.problem->proxy_count * columns;
    find_noise(gram);
    for (size_t b = 0; b < size; b += columns) {
        gram->matrix[b * size + b] += gram->noise;
    }
}

static void add_frames(pci_skin_gram *gram, const uint32_t frames[FRAMES_AT_ONCE]) {
    const pci_skin_frames *w = &gram->driver;
    const size_t size = w->problem->proxy_count * w->data.columns;
    gram_job job = {.rows = gram->rows, .size = size, .matrix = gram->matrix};
    for (size_t i = 0; i < FRAMES_AT_ONCE; ++i) {
        if (frames[i] != PC_INVALID_INDEX) {
            fill_rows(w, frames[i], &gram->rows[job.count * size]);
            job.count += 3;
        }
    }
    pci_parallel_for(w->context, size, 16, add_products, &job);
}

static void use_matrix(pci_skin_gram *gram, pci_skin_level level) {
    const pci_skin_frames *w = &gram->driver;
    const size_t size = w->problem->proxy_count * w->data.columns;
    const double factor = gram->levels[level].factor;
    if (gram->level == level) {
        return;
    }
    gram->level = level;
    memset(gram->matrix, 0, size * size * sizeof(*gram->matrix));
    for (size_t block = 0; block < w->block_count; block += gram->levels[level].stride) {
        for (size_t i = PCI_BLOCK * block; i < PCI_BLOCK * (block + 1); i += FRAMES_AT_ONCE) {
            add_frames(gram, &w->frames[i]);
        }
    }
    for (size_t b = 0; b < size; ++b) {
        for (size_t c = 0; c < b; ++c) {
            gram->matrix[c * size + b] = gram->matrix[b * size + c] *= factor;
        }
        gram->matrix[b * size + b] *= factor;
    }
    add_noise(gram);
}

// ---- without a matrix ---------------------------------------------------------------------------

// Sum of products of two rows of the table.
static double multiply_rows(const double *a, const double *b) {
    double sums[4] = {0.0};
    for (size_t t = 0; t < TABLE_ROWS; t += 4) {
        for (size_t i = 0; i < 4; ++i) {
            sums[i] += a[t + i] * b[t + i];
        }
    }
    return (sums[0] + sums[1]) + (sums[2] + sums[3]);
}

// Takes some blocks into the table, 0 in place of what is behind the last.
static void fill_table(pci_skin_gram *gram, size_t block, size_t stride) {
    const pci_skin_frames *w = &gram->driver;
    const size_t size = w->problem->proxy_count * w->data.columns;
    for (size_t i = 0; i < TABLE_FRAMES; ++i) {
        const size_t from = block + i / PCI_BLOCK * stride;
        const uint32_t frame =
            from < w->block_count ? w->frames[PCI_BLOCK * from + i % PCI_BLOCK] : PC_INVALID_INDEX;
        if (frame != PC_INVALID_INDEX) {
            fill_rows(w, frame, gram->rows);
        }
        for (size_t c = 0; c < 3; ++c) {
            for (size_t b = 0; b < size; ++b) {
                gram->table[b * TABLE_ROWS + 3 * i + c] =
                    frame != PC_INVALID_INDEX ? gram->rows[c * size + b] : 0.0;
            }
        }
    }
}

typedef struct pair_job {
    const pci_skin_gram *gram;
    pci_skin_pairs *pairs;
} pair_job;

static void add_pairs(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const pair_job *job = user;
    const pci_skin_pairs *pairs = job->pairs;
    const size_t width = job->gram->driver.data.columns;
    const double factor = job->gram->levels[job->gram->level].factor, *table = job->gram->table;
    for (size_t b = begin; b < end; ++b) {
        for (size_t e = pairs->offsets[b]; e < pairs->offsets[b + 1]; ++e) {
            for (size_t k = 0; k < width * width; ++k) {
                const size_t row = b * width + k / width;
                const size_t column = pairs->others[e] * width + k % width;
                pairs->values[e * width * width + k] +=
                    factor * multiply_rows(&table[row * TABLE_ROWS], &table[column * TABLE_ROWS]);
            }
        }
    }
}

static void add_pair_noise(const pci_skin_gram *gram, pci_skin_pairs *pairs) {
    const size_t width = gram->driver.data.columns;
    for (size_t b = 0; b < gram->driver.problem->proxy_count; ++b) {
        for (size_t e = pairs->offsets[b]; e < pairs->offsets[b + 1]; ++e) {
            pairs->values[e * width * width] += pairs->others[e] == b ? gram->noise : 0.0;
        }
    }
}

static void use_pairs(pci_skin_gram *gram, pci_skin_level level, pci_skin_pairs *pairs) {
    const pci_skin_frames *w = &gram->driver;
    const size_t width = w->data.columns, proxy_count = w->problem->proxy_count;
    const size_t stride = gram->levels[level].stride;
    double noise = 0.0;
    gram->level = level;
    if (pairs != NULL) {
        memset(pairs->values, 0,
               pairs->offsets[proxy_count] * width * width * sizeof(*pairs->values));
    }
    for (size_t block = 0; block < w->block_count; block += SAMPLE_BLOCKS * stride) {
        pair_job job = {.gram = gram, .pairs = pairs};
        fill_table(gram, block, stride);
        find_noise(gram);
        noise += gram->noise;
        if (pairs != NULL) {
            pci_parallel_for(w->context, proxy_count, 64, add_pairs, &job);
        }
    }
    gram->noise = noise;
    if (pairs != NULL) {
        add_pair_noise(gram, pairs);
    }
}

double pci_skin_gram_sample(const pci_skin_gram *gram, size_t columns, size_t b, size_t c,
                            const double *x, const double *y) {
    if (gram->matrix != NULL) {
        return pci_skin_gram_product(gram->matrix, gram->driver.problem->proxy_count, columns, b, c,
                                     x, y);
    }
    double sum = b == c ? gram->noise * x[0] * y[0] : 0.0;
    for (size_t k = 0; k < columns * columns; ++k) {
        const size_t row = b * columns + k / columns, column = c * columns + k % columns;
        sum += gram->levels[gram->level].factor * x[k / columns] * y[k % columns] *
               multiply_rows(&gram->table[row * TABLE_ROWS], &gram->table[column * TABLE_ROWS]);
    }
    return sum;
}

void pci_skin_gram_use(pci_skin_gram *gram, pci_skin_level level, pci_skin_pairs *pairs) {
    if (gram->matrix != NULL) {
        use_matrix(gram, level);
    } else if (gram->level != level || pairs != NULL) {
        use_pairs(gram, level, pairs);
    }
}

// `stride`: from one block to the next that is looked at.
static pci_skin_frame_level describe_level(const pci_skin_frames *w, size_t stride) {
    size_t count = 0;
    for (size_t i = 0; i < w->block_count * PCI_BLOCK; ++i) {
        count += i / PCI_BLOCK % stride == 0 && w->frames[i] != PC_INVALID_INDEX;
    }
    const pci_skin_frame_level level = {stride, (double)w->problem->frame_count / (double)count};
    return level;
}

bool pci_skin_gram_build(pci_scratch *scratch, const pci_skin_problem *problem,
                         const pci_skin_kernel *kernel, const pc_mesh *proxy, double noise,
                         size_t dense_most, pci_skin_gram *gram) {
    memset(gram, 0, sizeof(*gram));
    pci_skin_frames *w = &gram->driver;
    pci_skin_frames_begin(scratch->context, problem, kernel, w);
    const size_t size = problem->proxy_count * w->data.columns;
    w->frames = pci_skin_frames_in_sequence(scratch, problem, &w->block_count);
    if (size <= dense_most) {
        gram->matrix = PCI_SCRATCH(scratch, double, size *size);
    } else {
        gram->table = PCI_SCRATCH(scratch, double, size *TABLE_ROWS);
    }
    gram->rows = PCI_SCRATCH(scratch, double, 3 * FRAMES_AT_ONCE * size);
    if (scratch->failed) {
        return false;
    }
    gram->levels[PCI_SKIN_ALL] = describe_level(w, 1);
    gram->levels[PCI_SKIN_SAMPLE] =
        describe_level(w, (w->block_count + SAMPLE_BLOCKS - 1) / SAMPLE_BLOCKS);
    gram->proxy = proxy;
    gram->noise_share = noise;
    gram->level = PCI_SKIN_LEVELS;
    pci_skin_gram_use(gram, PCI_SKIN_SAMPLE, NULL);
    return true;
}
