#include "stages/skin/skin_quadratic.h"

#include <float.h>

#include "stages/skin/skin_frames.h"
#include "stages/skin/skin_matrix.h"
#include "stages/skin/skin_simplex.h"

enum { TRIAL_SWEEPS = 2 }; // that choose the slots anew before the others are taken away

static const double ridge_share = 1e-7; // of the trace of a block, keeps it definite

// Largest numbers of what a group needs.
typedef struct group_sizes {
    size_t rows, own_bones, bones;
} group_sizes;

// How many bones of some vertices do not have this mark yet.
static size_t count_bones(const pci_skin_quadratic *q, const uint32_t *vertices, size_t count,
                          uint32_t mark, uint32_t *marks) {
    size_t bones = 0;
    for (size_t i = 0; i < count * q->slots; ++i) {
        const uint32_t bone = q->bones[q->slots * vertices[i / q->slots] + i % q->slots];
        bones += marks[bone] != mark;
        marks[bone] = mark;
    }
    return bones;
}

static bool find_group_sizes(pci_scratch *scratch, const pci_skin_quadratic *q,
                             group_sizes *sizes) {
    pci_scratch local = pci_scratch_begin(scratch->context);
    uint32_t *marks = PCI_SCRATCH(&local, uint32_t, q->proxy_count);
    const bool good = !local.failed;
    memset(sizes, 0, sizeof(*sizes));
    for (uint32_t g = 0; g < q->group_count && good; ++g) {
        const uint32_t *known = &q->known[q->known_offsets[g]];
        const size_t own = pci_skin_group_begin(q, g + 1) - pci_skin_group_begin(q, g);
        const size_t rows = q->known_offsets[g + 1] - q->known_offsets[g];
        const size_t own_bones = count_bones(q, known, own, g + 1, marks);
        const size_t bones = own_bones + count_bones(q, &known[own], rows - own, g + 1, marks);
        sizes->rows = rows > sizes->rows ? rows : sizes->rows;
        sizes->own_bones = own_bones > sizes->own_bones ? own_bones : sizes->own_bones;
        sizes->bones = bones > sizes->bones ? bones : sizes->bones;
    }
    pci_scratch_end(&local);
    return good;
}

static size_t row_stride(const pci_skin_quadratic *q, size_t bones) {
    return (q->width * bones + PCI_SKIN_STRIDE - 1) / PCI_SKIN_STRIDE * PCI_SKIN_STRIDE;
}

// F is kept of faces of so many slots, of larger ones while their group is loaded.
enum { KEPT_SLOTS = 8, LOADED_SLOTS = 16 };

static size_t triangle_size(size_t slots) { return slots * (slots - 1) / 2; }

static size_t kept_size(const pci_skin_quadratic *q) {
    return triangle_size(q->widest < q->kept ? q->widest : q->kept);
}

// Room for the largest group, for each thread.
static bool build_loaded(pci_scratch *scratch, pci_skin_quadratic *q) {
    const uint32_t threads = pc_context_threads(scratch->context);
    group_sizes sizes;
    q->loaded = PCI_SCRATCH(scratch, pci_skin_group, threads);
    q->finished = PCI_SCRATCH(scratch, atomic_uint, q->group_count);
    if (scratch->failed || !find_group_sizes(scratch, q, &sizes)) {
        return false;
    }
    const size_t stride = row_stride(q, sizes.bones), width = q->width * sizes.own_bones;
    for (uint32_t i = 0; i < threads; ++i) {
        pci_skin_group *g = &q->loaded[i];
        g->bone_numbers = PCI_SCRATCH(scratch, uint32_t, q->proxy_count);
        g->places = PCI_SCRATCH(scratch, uint32_t, (size_t)PCI_SKIN_GROUP * q->slots);
        g->bones = PCI_SCRATCH(scratch, uint32_t, sizes.bones);
        g->moves = PCI_SCRATCH(scratch, pci_skin_move, sizes.rows * q->slots + 1);
        g->moved = pci_scratch_allocate_aligned(scratch, sizes.rows * stride, sizeof(float));
        g->gram = pci_scratch_allocate_aligned(scratch, width * stride, sizeof(float));
        g->own_gram = PCI_SCRATCH(scratch, double, width *width);
        g->faces = PCI_SCRATCH(scratch, uint32_t, PCI_SKIN_GROUP);
        g->factors = PCI_SCRATCH(scratch, float, PCI_SKIN_GROUP *triangle_size(LOADED_SLOTS));
        g->sum = pci_scratch_allocate_aligned(scratch, stride, sizeof(float));
    }
    return !scratch->failed;
}

bool pci_skin_quadratic_build(pci_scratch *scratch, const pci_skin_problem *problem,
                              const pci_skin_kernel *kernel, const double *points,
                              const double scale[4], double diagonal, const double *gram,
                              const uint32_t *allowed, pci_skin_quadratic *q) {
    memset(q, 0, sizeof(*q));
    q->kernel = kernel;
    q->context = scratch->context;
    q->vertex_count = problem->vertex_count;
    q->proxy_count = problem->proxy_count;
    q->slots = q->widest = problem->slots;
    q->bones = problem->bones;
    q->width = pci_skin_columns(problem);
    q->points = points;
    q->gram = gram;
    q->allowed = allowed;
    q->kept = problem->coarse ? LOADED_SLOTS : KEPT_SLOTS;
    q->faces = PCI_SCRATCH(scratch, uint32_t, q->vertex_count);
    q->factors = PCI_SCRATCH(scratch, float, q->vertex_count *kept_size(q));
    return !scratch->failed && pci_skin_matrix_build(scratch, problem, scale, diagonal, q) &&
           build_loaded(scratch, q);
}

bool pci_skin_quadratic_weigh(pci_scratch *scratch, const pci_skin_problem *problem,
                              const double scale[4], double diagonal, pci_skin_quadratic *q) {
    return pci_skin_matrix_fill(scratch, problem, scale, diagonal, q);
}

void pci_skin_quadratic_use(pci_skin_quadratic *q, uint32_t slots) {
    memset(q->faces, 0, q->vertex_count * sizeof(*q->faces));
    q->slots = slots;
}

// ---- sweeps -------------------------------------------------------------------------------------

typedef struct sweep_job {
    const pci_skin_quadratic *q;
    float *const *gradient; // #groups
    float *moved;           // w - w0
    double *weights;
    uint32_t kept;     // slots to keep, or 0
    uint32_t *allowed; // of the quadratic, if slots are taken away for good
} sweep_job;

static inline void fetch(const void *memory, size_t size) {
    for (size_t at = 0; at < size; at += 64) {
        __builtin_prefetch((const char *)memory + at);
    }
}

static void number_bone(pci_skin_group *g, uint32_t bone) {
    if (g->bone_numbers[bone] == 0) {
        g->bones[g->bone_count] = bone;
        g->bone_numbers[bone] = ++g->bone_count;
    }
}

// Numbers the bones of a group: those that its own rows may use, then those along which any row has
// moved.
static void number_bones(const sweep_job *job, uint32_t group, pci_skin_group *g) {
    const pci_skin_quadratic *q = job->q;
    g->first = pci_skin_group_begin(q, group);
    g->own_count = (uint32_t)(pci_skin_group_begin(q, (size_t)group + 1) - g->first);
    g->vertices = &q->known[q->known_offsets[group]];
    g->row_count = (uint32_t)(q->known_offsets[group + 1] - q->known_offsets[group]);
    g->gradient = job->gradient[group];
    g->bone_count = 0;
    for (size_t row = 0; row < g->own_count; ++row) {
        const size_t v = g->vertices[row];
        for (uint32_t k = 0; k < q->slots; ++k) {
            if (q->allowed[v] >> k & 1) {
                const uint32_t bone = q->bones[v * q->slots + k];
                number_bone(g, bone);
                g->places[row * q->slots + k] = g->bone_numbers[bone] - 1;
            }
        }
    }
    g->own_bone_count = g->bone_count;
    enum { AHEAD = 8 };
    // Which slots have moved no processor foresees: all are written, those that have stay.
    size_t count = 0;
    for (uint32_t row = 0; row < g->row_count; ++row) {
        const size_t begin = q->slots * (size_t)g->vertices[row];
        if (row + AHEAD < g->row_count) {
            const size_t later = q->slots * (size_t)g->vertices[row + AHEAD];
            fetch(&q->bones[later], q->slots * sizeof(*q->bones));
            fetch(&job->moved[later], q->slots * sizeof(*job->moved));
        }
        for (size_t slot = begin; slot < begin + q->slots; ++slot) {
            const pci_skin_move move = {row, q->bones[slot], job->moved[slot]};
            g->moves[count] = move;
            count += move.step != 0.0f;
        }
    }
    g->move_count = count;
    for (size_t i = 0; i < count; ++i) {
        number_bone(g, g->moves[i].bone);
        g->moves[i].bone = g->bone_numbers[g->moves[i].bone] - 1;
    }
    g->stride = row_stride(q, g->bone_count);
}

// What the rows have moved. `width` is that of the quadratic, known where this is compiled.
static inline __attribute__((always_inline)) void
load_moves(const pci_skin_quadratic *q, const size_t width, pci_skin_group *g) {
    memset(g->moved, 0, g->row_count * g->stride * sizeof(*g->moved));
    for (size_t i = 0; i < g->move_count; ++i) {
        const pci_skin_move *move = &g->moves[i];
        float *moved = &g->moved[move->row * g->stride + width * move->bone];
        const double *x = &q->points[pci_skin_point_at(g->vertices[move->row], width)];
        for (size_t k = 0; k < width; ++k) {
            moved[k] = (float)((double)move->step * x[k]);
        }
    }
}

// The rows of G of the own bones. `width` likewise.
static inline __attribute__((always_inline)) void load_gram(const pci_skin_quadratic *q,
                                                            const size_t width, pci_skin_group *g) {
    const size_t own = width * g->own_bone_count, count = width * g->bone_count;
    for (size_t b = 0; b < own; ++b) {
        const size_t from = width * g->bones[b / width] + b % width;
        const double *row = &q->gram[width * q->proxy_count * from];
        float *to = &g->gram[b * g->stride];
        for (size_t c = 0; c < count; ++c) {
            to[c] = (float)row[width * g->bones[c / width] + c % width];
        }
        for (size_t c = 0; c < own; ++c) {
            g->own_gram[b * own + c] = row[width * g->bones[c / width] + c % width];
        }
        memset(&to[count], 0, (g->stride - count) * sizeof(*to));
    }
}

// The same from pairs; 0 where none is needed.
static void load_pairs(const pci_skin_quadratic *q, pci_skin_group *g) {
    const size_t width = q->width, own = width * g->own_bone_count;
    memset(g->gram, 0, own * g->stride * sizeof(*g->gram));
    memset(g->own_gram, 0, own * own * sizeof(*g->own_gram));
    for (size_t b = 0; b < g->own_bone_count; ++b) {
        const uint32_t bone = g->bones[b];
        for (size_t e = q->pairs->offsets[bone]; e < q->pairs->offsets[bone + 1]; ++e) {
            const size_t number = g->bone_numbers[q->pairs->others[e]];
            for (size_t k = 0; k < width * width && number > 0; ++k) {
                const size_t row = b * width + k / width;
                const size_t column = (number - 1) * width + k % width;
                const double value = q->pairs->values[e * width * width + k];
                g->gram[row * g->stride + column] = (float)value;
                if (number <= g->own_bone_count) {
                    g->own_gram[row * own + column] = value;
                }
            }
        }
    }
}

static void load_group(const sweep_job *job, uint32_t group, pci_skin_group *g) {
    const pci_skin_quadratic *q = job->q;
    number_bones(job, group, g);
    memset(g->faces, 0, g->own_count * sizeof(*g->faces));
    if (q->width == 1) {
        load_moves(q, 1, g);
    } else {
        load_moves(q, PCI_SKIN_COLUMNS_MAX, g);
    }
    if (q->gram == NULL) {
        load_pairs(q, g);
    } else if (q->width == 1) {
        load_gram(q, 1, g);
    } else {
        load_gram(q, PCI_SKIN_COLUMNS_MAX, g);
    }
    for (size_t b = 0; b < g->bone_count; ++b) {
        g->bone_numbers[g->bones[b]] = 0;
    }
}

// One row as a small program over its allowed slots.
typedef struct row_program {
    uint32_t count;
    uint32_t slots[PCI_SKIN_SLOTS_MAX];
    size_t places[PCI_SKIN_SLOTS_MAX]; // in the matrix of the group
    double diagonal;                   // M_ii
    double weights[PCI_SKIN_SLOTS_MAX], gradient[PCI_SKIN_SLOTS_MAX];
    double a[PCI_SKIN_SLOTS_MAX * PCI_SKIN_SLOTS_MAX];
} row_program;

// `width` is that of the quadratic, known where this is compiled; `place`s are those of slots.
static inline __attribute__((always_inline)) double row_product(const pci_skin_quadratic *q,
                                                                const pci_skin_group *g,
                                                                const size_t width, size_t row,
                                                                size_t place, size_t other) {
    const double *x = &q->points[pci_skin_point_at(g->vertices[row], width)];
    return pci_skin_gram_product(g->own_gram, g->own_bone_count, width, place, other, x, x);
}

// `factor` times x^T G x of some slots of a row. Returns the ridge that belongs to it.
static inline __attribute__((always_inline)) double
fill_matrix(const pci_skin_quadratic *q, const pci_skin_group *g, const size_t width, size_t row,
            double factor, uint32_t count, const size_t *places, double *a) {
    double trace = 0.0;
    for (uint32_t i = 0; i < count; ++i) {
        for (uint32_t j = 0; j <= i; ++j) {
            a[i * count + j] = a[j * count + i] =
                factor * row_product(q, g, width, row, places[i], places[j]);
        }
        trace += a[i * count + i];
    }
    return ridge_share * trace + (double)FLT_MIN;
}

static inline __attribute__((always_inline)) void extract_row(const sweep_job *job, size_t row,
                                                              const pci_skin_group *g,
                                                              const size_t width, row_program *r) {
    const pci_skin_quadratic *q = job->q;
    const size_t v = g->vertices[row], first = q->offsets[g->first + row];
    const double *x = &q->points[pci_skin_point_at(v, width)];
    uint32_t numbers[PCI_SKIN_SLOTS_MAX * PCI_SKIN_COLUMNS_MAX];
    float products[PCI_SKIN_SLOTS_MAX * PCI_SKIN_COLUMNS_MAX];
    r->diagonal = (double)q->values[first];
    r->count = 0;
    for (uint32_t k = 0; k < q->slots; ++k) {
        if (q->allowed[v] >> k & 1) {
            const uint32_t place = g->places[row * q->slots + k];
            for (uint32_t c = 0; c < width; ++c) {
                numbers[width * r->count + c] = (uint32_t)width * place + c;
            }
            r->places[r->count] = place;
            r->slots[r->count] = k;
            r->weights[r->count++] = job->weights[v * q->slots + k];
        }
    }
    const pci_skin_rows rows = {.stride = g->stride,
                                .moved = g->moved,
                                .gram = g->gram,
                                .entry_count = q->offsets[g->first + row + 1] - first,
                                .entries = &q->entries[first],
                                .values = &q->values[first]};
    q->kernel->multiply_rows(&rows, width * r->count, numbers, g->sum, products);
    for (uint32_t i = 0; i < r->count; ++i) {
        double sum = (double)products[width * i];
        for (size_t k = 1; k < width; ++k) {
            sum += x[k] * (double)products[width * i + k];
        }
        r->gradient[i] = (double)g->gradient[row * q->slots + r->slots[i]] + sum;
    }
}

// The slots of a row that have weight.
typedef struct row_face {
    uint32_t count, bits;
    uint32_t members[PCI_SKIN_SLOTS_MAX]; // of the program
    size_t places[PCI_SKIN_SLOTS_MAX];
} row_face;

static void find_face(const row_program *r, row_face *face) {
    face->count = face->bits = 0;
    for (uint32_t i = 0; i < r->count; ++i) {
        if (r->weights[i] > 0.0) {
            face->places[face->count] = r->places[i];
            face->members[face->count++] = i;
            face->bits |= (uint32_t)1 << r->slots[i];
        }
    }
}

static inline __attribute__((always_inline)) void find_factor(const pci_skin_quadratic *q,
                                                              const pci_skin_group *g,
                                                              const size_t width, size_t row,
                                                              const row_face *face, float *factor) {
    double a[PCI_SKIN_SLOTS_MAX * PCI_SKIN_SLOTS_MAX], f[LOADED_SLOTS * LOADED_SLOTS];
    const double ridge = fill_matrix(q, g, width, row, 1.0, face->count, face->places, a);
    pci_simplex_factor(face->count, ridge, a, f);
    for (size_t i = 0; i < triangle_size(face->count); ++i) {
        factor[i] = (float)f[i];
    }
}

// Compiled for each small n: most of the time would go into the ends of short loops.
static inline __attribute__((always_inline)) bool step_on_n(const uint32_t n, const row_face *face,
                                                            const float *factor,
                                                            const row_program *r, double *step) {
    const double first = r->gradient[face->members[0]], scale = -1.0 / r->diagonal;
    double g[PCI_SKIN_SLOTS_MAX], sum = 0.0;
    for (uint32_t i = 0; i < n; ++i) {
        g[i] = r->gradient[face->members[i]] - first;
        step[i] = 0.0;
    }
    for (uint32_t i = 1; i < n; ++i) {
        double y = 0.0;
        for (uint32_t j = 0; j < i; ++j) {
            y += (double)factor[j] * g[j + 1];
        }
        for (uint32_t j = 0; j < i; ++j) {
            step[j + 1] += (double)factor[j] * y;
        }
        factor += i;
    }
    bool inside = true;
    for (uint32_t i = 1; i < n; ++i) {
        step[i] *= scale;
        sum += step[i];
        inside = inside && r->weights[face->members[i]] + step[i] >= 0.0;
    }
    step[0] = -sum;
    return inside && r->weights[face->members[0]] + step[0] >= 0.0;
}

// Steps to the minimum on a face, from F. False: it lies outside of the simplex.
static bool step_on_face(const row_face *face, const float *factor, const row_program *r,
                         double *step) {
    switch (face->count) {
    case 1:
        return step_on_n(1, face, factor, r, step);
    case 2:
        return step_on_n(2, face, factor, r, step);
    case 3:
        return step_on_n(3, face, factor, r, step);
    case 4:
        return step_on_n(4, face, factor, r, step);
    case 5:
        return step_on_n(5, face, factor, r, step);
    case 6:
        return step_on_n(6, face, factor, r, step);
    case 7:
        return step_on_n(7, face, factor, r, step);
    case 8:
        return step_on_n(8, face, factor, r, step);
    default:
        return step_on_n(face->count, face, factor, r, step);
    }
}

// dE/dw of one slot after a step on a face.
static inline __attribute__((always_inline)) double
slope_after(const pci_skin_quadratic *q, const pci_skin_group *g, const size_t width, size_t row,
            const row_face *face, const row_program *r, const double *step, uint32_t member) {
    double slope = 0.0;
    for (uint32_t j = 0; j < face->count; ++j) {
        slope += step[j] * row_product(q, g, width, row, r->places[member], face->places[j]);
    }
    return r->gradient[member] + r->diagonal * slope;
}

// Minimises a row whose minimum lies on the face that it is on, which is nearly always so. False:
// it does not.
static inline __attribute__((always_inline)) bool minimize_on_face(const sweep_job *job,
                                                                   const pci_skin_group *g,
                                                                   const size_t width, size_t row,
                                                                   row_program *r) {
    const pci_skin_quadratic *q = job->q;
    double step[PCI_SKIN_SLOTS_MAX];
    row_face face;
    find_face(r, &face);
    if (face.count == 0 || face.count > LOADED_SLOTS) {
        return false;
    }
    const size_t member = g->first + row;
    const bool kept = face.count <= q->kept;
    uint32_t *known = kept ? &q->faces[member] : &g->faces[row];
    float *factor =
        kept ? &q->factors[member * kept_size(q)] : &g->factors[row * triangle_size(LOADED_SLOTS)];
    if (*known != face.bits) {
        find_factor(q, g, width, row, &face, factor);
        *known = face.bits;
    }
    if (!step_on_face(&face, factor, r, step)) {
        return false;
    }
    if (face.count < r->count) {
        const double multiplier = slope_after(q, g, width, row, &face, r, step, face.members[0]);
        for (uint32_t i = 0; i < r->count; ++i) {
            if (!(r->weights[i] > 0.0) &&
                pci_simplex_enters(slope_after(q, g, width, row, &face, r, step, i), multiplier)) {
                return false;
            }
        }
    }
    for (uint32_t i = 0; i < face.count; ++i) {
        r->weights[face.members[i]] += step[i];
    }
    pci_simplex_round(r->count, r->weights);
    return true;
}

// Gives a row the weights of its program.
static inline __attribute__((always_inline)) void move_row(const sweep_job *job, size_t row,
                                                           const row_program *r, const size_t width,
                                                           pci_skin_group *g) {
    const pci_skin_quadratic *q = job->q;
    const size_t v = g->vertices[row];
    const double *x = &q->points[pci_skin_point_at(v, width)];
    float *row_moved = &g->moved[row * g->stride];
    for (uint32_t i = 0; i < r->count; ++i) {
        const size_t at = v * q->slots + r->slots[i];
        const double step = (double)job->moved[at] + (r->weights[i] - job->weights[at]);
        job->weights[at] = r->weights[i];
        job->moved[at] = (float)step;
        for (size_t k = 0; k < width; ++k) {
            row_moved[width * r->places[i] + k] = (float)(step * x[k]);
        }
    }
}

static inline __attribute__((always_inline)) void
minimize_row(const sweep_job *job, size_t row, const size_t width, pci_skin_group *g) {
    const size_t v = g->vertices[row];
    row_program r;
    if (job->q->allowed[v] == 0) {
        return;
    }
    extract_row(job, row, g, width, &r);
    if (job->kept > 0 || !minimize_on_face(job, g, width, row, &r)) {
        const uint32_t kept = job->kept > 0 && job->kept < r.count ? job->kept : r.count;
        const double ridge = fill_matrix(job->q, g, width, row, r.diagonal, r.count, r.places, r.a);
        const uint64_t left = pci_simplex_prune(r.count, r.a, ridge, kept, r.weights, r.gradient);
        for (uint32_t i = 0; i < r.count && job->allowed != NULL; ++i) {
            if ((left >> i & 1) == 0) {
                job->allowed[v] &= ~((uint32_t)1 << r.slots[i]);
            }
        }
    }
    move_row(job, row, &r, width, g);
}

// Rows that follow one another are far apart in arrays by vertex.
static void fetch_row(const sweep_job *job, size_t v) {
    const size_t slots = job->q->slots, first = v * slots;
    fetch(&job->weights[first], slots * sizeof(*job->weights));
    fetch(&job->moved[first], slots * sizeof(*job->moved));
}

// Visits the rows of a group in order, or from the last to the first.
static void visit_group(const sweep_job *job, bool backward, pci_skin_group *g) {
    for (size_t m = 0; m < g->own_count; ++m) {
        const size_t row = backward ? g->own_count - 1 - m : m;
        if (m + 1 < g->own_count) {
            fetch_row(job, g->vertices[backward ? row - 1 : row + 1]);
        }
        if (job->q->width == 1) {
            minimize_row(job, row, 1, g);
        } else {
            minimize_row(job, row, PCI_SKIN_COLUMNS_MAX, g);
        }
    }
}

// Waits until the neighbours of a group stand as if all groups were visited in turn: those that
// come before it have finished this sweep, the others the last one.
static void wait_for_neighbours(const pci_skin_quadratic *q, uint32_t group, uint32_t sweep) {
    const bool backward = sweep % 2 == 1;
    const uint32_t colour = q->colours[group];
    for (size_t i = q->known_offsets[group]; i < q->known_offsets[group + 1]; ++i) {
        const uint32_t other = q->group_of[q->known[i]];
        const bool before = backward ? q->colours[other] > colour : q->colours[other] < colour;
        pci_parallel_wait(q->context, &q->finished[other], before ? sweep + 1 : sweep);
    }
}

// Visits groups by sweep and turn. No barrier is needed between colours or sweeps.
static void sweep_groups(void *user, size_t begin, size_t end, uint32_t worker) {
    const sweep_job *job = user;
    const pci_skin_quadratic *q = job->q;
    for (size_t i = begin; i < end; ++i) {
        const uint32_t sweep = (uint32_t)(i / q->group_count),
                       turn = (uint32_t)(i % q->group_count);
        const uint32_t group = q->groups[sweep % 2 * q->group_count + turn];
        pci_skin_group *g = &q->loaded[worker];
        wait_for_neighbours(q, group, sweep);
        load_group(job, group, g);
        visit_group(job, false, g);
        if (job->kept == 0) {
            visit_group(job, true, g);
        }
        atomic_store_explicit(&q->finished[group], sweep + 1, memory_order_release);
    }
}

static void run_sweeps(sweep_job *job, uint32_t sweeps) {
    const pci_skin_quadratic *q = job->q;
    for (uint32_t g = 0; g < q->group_count; ++g) {
        atomic_store_explicit(&q->finished[g], 0, memory_order_relaxed);
    }
    pci_parallel_for(q->context, (size_t)sweeps * q->group_count, 1, sweep_groups, job);
}

void pci_skin_quadratic_sweep(const pci_skin_quadratic *q, float *const *gradient, uint32_t sweeps,
                              float *moved, double *weights) {
    sweep_job job = {.q = q, .gradient = gradient, .moved = moved, .weights = weights};
    run_sweeps(&job, sweeps);
}

void pci_skin_quadratic_prune(const pci_skin_quadratic *q, float *const *gradient, uint32_t kept,
                              uint32_t *allowed, float *moved, double *weights) {
    sweep_job job = {
        .q = q, .gradient = gradient, .moved = moved, .weights = weights, .kept = kept};
    run_sweeps(&job, TRIAL_SWEEPS);
    job.allowed = allowed;
    run_sweeps(&job, 1);
}
