// What every module builds on: errors, memory, threads, random numbers.
#ifndef PCI_CORE_H
#define PCI_CORE_H

#include <math.h>
#include <stdatomic.h>
#include <string.h>

#include "proxycloth/base.h"
#include "proxycloth/options.h"

// How much is done for the sake of quality only. Fuzz builds do a little of everything, so that a
// run takes a millisecond and libFuzzer tries a million.
#ifdef PROXYCLOTH_FUZZ
#define PCI_EFFORT(usual, fuzzed) (fuzzed)
#else
#define PCI_EFFORT(usual, fuzzed) (usual)
#endif

// ---- errors -----------------------------------------------------------------------------------

// Records the error in the context and returns `status`.
__attribute__((format(printf, 4, 5))) pc_status
pci_fail(pc_context *context, pc_status status, const char *stage, const char *format, ...);

// Out of memory, with the usual message; or cancelled, when pci_keep_going returned false in a
// function that can only say that it did not finish.
pc_status pci_fail_memory(pc_context *context, const char *stage);

__attribute__((format(printf, 4, 5))) void pci_log(pc_context *context, pc_log_level level,
                                                   const char *stage, const char *format, ...);

// ---- stages -------------------------------------------------------------------------------------

// What every stage does with its options: copies `given` (NULL: the defaults) to `chosen`, then
// checks the ranges. Progress counts for this stage from now on. PC_OK; PC_ERROR_INVALID_OPTIONS.
PC_NODISCARD pc_status pci_begin_stage(pc_context *context, const char *stage,
                                       const pc_record *record, const void *given, void *chosen);

// Reports progress; false when the user cancelled. Only from the thread that entered the library.
bool pci_progress(pc_context *context, const char *stage, double fraction);

// For long loops between two reports: repeats the last one, ten times a second at most. Likewise.
bool pci_keep_going(pc_context *context);

pc_status pci_fail_cancelled(pc_context *context, const char *stage);

#ifdef __clang_analyzer__ // which sees one file at a time: failures never return PC_OK. The
                          // functions themselves are defined with their names in parentheses.
static inline pc_status pci_failure(pc_status status) {
    if (status == PC_OK) {
        __builtin_unreachable();
    }
    return status;
}
#define pci_fail(...)           pci_failure(pci_fail(__VA_ARGS__))
#define pci_fail_memory(...)    pci_failure(pci_fail_memory(__VA_ARGS__))
#define pci_fail_cancelled(...) pci_failure(pci_fail_cancelled(__VA_ARGS__))
#endif

// ---- memory that outlives the call --------------------------------------------------------------

// Zeroed memory for count * size bytes, or NULL (also when the product overflows). A count of 0
// gives a valid pointer.
void *pci_allocate(pc_context *context, size_t count, size_t size);
#define PCI_ALLOCATE(context, type, count) ((type *)pci_allocate((context), (count), sizeof(type)))

// The C library keeps what is released in pieces. Gives it back to the system, if that is much.
void pci_give_back(const pc_context *context);

// ---- scratch memory of one call -----------------------------------------------------------------

// A list of allocations that is released as a whole. After the first failure `failed` stays set, so
// a function may allocate several arrays and check once.
typedef struct pci_scratch {
    pc_context *context;
    struct pci_scratch_block *blocks;
    bool failed;
} pci_scratch;

pci_scratch pci_scratch_begin(pc_context *context);
void pci_scratch_end(pci_scratch *scratch);
// Releases one piece before the others; not of those that are aligned. NULL is accepted.
void pci_scratch_release(pci_scratch *scratch, void *memory);
// Releases what was allocated since `blocks` was `mark`.
void pci_scratch_rewind(pci_scratch *scratch, const struct pci_scratch_block *mark);
// Hands over what was allocated in another one, of a task.
void pci_scratch_take(pci_scratch *scratch, pci_scratch *from);
// Zeroed; NULL on failure, which also sets `failed`.
void *pci_scratch_allocate(pci_scratch *scratch, size_t count, size_t size);
// The same, aligned to 64 bytes: a line of the cache, and the widest register.
void *pci_scratch_allocate_aligned(pci_scratch *scratch, size_t count, size_t size);
#define PCI_SCRATCH(scratch, type, count)                                                          \
    ((type *)pci_scratch_allocate((scratch), (count), sizeof(type)))

// Makes room for `needed` elements in an array from scratch memory, at least doubling it; the old
// contents are kept. Returns false on failure.
bool pci_scratch_reserve(pci_scratch *scratch, void **array, size_t *capacity, size_t needed,
                         size_t element_size);

// ---- threads ----------------------------------------------------------------------------------

// Calls body(user, begin, end, worker) for consecutive pieces of 0..count, each at most `grain`
// long and starting at a multiple of `grain`, so that results can be stored per piece and combined
// in order, independent of the number of threads. `worker` < pc_context_threads(). Pieces are begun
// in order; returns when all are done.
typedef void (*pci_parallel_body)(void *user, size_t begin, size_t end, uint32_t worker);
void pci_parallel_for(pc_context *context, size_t count, size_t grain, pci_parallel_body body,
                      void *user);
// For long loops: asks pci_keep_going between the pieces. False: cancelled, pieces are missing.
PC_NODISCARD bool pci_parallel_while_wanted(pc_context *context, size_t count, size_t grain,
                                            pci_parallel_body body, void *user);

// In a piece: waits until an earlier piece has set `count` to at least `least`; what that piece
// wrote before, with memory_order_release, is seen then.
void pci_parallel_wait(pc_context *context, const atomic_uint *count, uint32_t least);

// Calls task(user, i, own) for i < count and returns the status of the first one that failed; later
// ones may be left out then. Where there are tasks for at least half of the threads they run side
// by side, each with a context of its own whose loops stay on its thread; else one after the other,
// with `context`.
typedef pc_status (*pci_task)(void *user, size_t index, pc_context *own);
PC_NODISCARD pc_status pci_run_tasks(pc_context *context, size_t count, pci_task task, void *user);

// ---- random numbers -----------------------------------------------------------------------------

// Counter-based: the value depends on the arguments only, never on the order of calls.
uint64_t pci_random_bits(uint64_t seed, uint64_t stream, uint64_t counter);
// Uniform in [0, 1).
double pci_random(uint64_t seed, uint64_t stream, uint64_t counter);

// ---- sorting ------------------------------------------------------------------------------------

// For qsort over uint64_t, ascending.
static inline int pci_compare_u64(const void *left, const void *right) {
    const uint64_t a = *(const uint64_t *)left, b = *(const uint64_t *)right;
    return (a > b) - (a < b);
}

// ---- vectors ------------------------------------------------------------------------------------

#define PCI_PI 3.14159265358979323846

// One instruction each, unlike fmin and fmax, which know NaN.
static inline double pci_smaller(double a, double b) { return a < b ? a : b; }
static inline double pci_larger(double a, double b) { return a > b ? a : b; }

static inline double pci_dot(const double a[3], const double b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
static inline void pci_sub(const double a[3], const double b[3], double out[3]) {
    out[0] = a[0] - b[0], out[1] = a[1] - b[1], out[2] = a[2] - b[2];
}
static inline void pci_cross(const double a[3], const double b[3], double out[3]) {
    const double x = a[1] * b[2] - a[2] * b[1];
    const double y = a[2] * b[0] - a[0] * b[2];
    const double z = a[0] * b[1] - a[1] * b[0];
    out[0] = x, out[1] = y, out[2] = z;
}
// The normal of a triangle, twice as long as its area is large.
static inline void pci_normal_of(const double a[3], const double b[3], const double c[3],
                                 double out[3]) {
    double ab[3], ac[3];
    pci_sub(b, a, ab);
    pci_sub(c, a, ac);
    pci_cross(ab, ac, out);
}
static inline double pci_norm(const double a[3]) { return sqrt(pci_dot(a, a)); }
static inline double pci_squared_distance(const double a[3], const double b[3]) {
    const double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
    return x * x + y * y + z * z;
}
// Scales to length 1; false and unchanged when the length is 0.
static inline bool pci_normalize(double a[3]) {
    const double length = pci_norm(a);
    if (!(length > 0.0)) {
        return false;
    }
    a[0] /= length, a[1] /= length, a[2] /= length;
    return true;
}

// ---- descriptions of structs -------------------------------------------------------------------

#define PCI_FIELD_OPTION(struct_type, member, kind, default_, min_, max_, unit_, help_)            \
    {                                                                                              \
        .name = #member, .type = PC_FIELD_##kind, .offset = offsetof(struct_type, member),         \
        .default_value = (default_), .minimum = (min_), .maximum = (max_), .unit = (unit_),        \
        .help = (help_)                                                                            \
    }
// A whole number that `zero_`, a word, may replace; the value is then 0.
#define PCI_FIELD_OPTION_OR(struct_type, member, kind, default_, min_, max_, unit_, zero_, help_)  \
    {                                                                                              \
        .name = #member, .type = PC_FIELD_##kind, .offset = offsetof(struct_type, member),         \
        .default_value = (default_), .minimum = (min_), .maximum = (max_), .unit = (unit_),        \
        .zero = (zero_), .help = (help_)                                                           \
    }
#define PCI_FIELD_CHOICE(struct_type, member, default_, last_, choices_, help_)                    \
    {                                                                                              \
        .name = #member, .type = PC_FIELD_CHOICE, .offset = offsetof(struct_type, member),         \
        .default_value = (default_), .minimum = 0, .maximum = (last_), .unit = "",                 \
        .help = (help_), .choices = (choices_)                                                     \
    }
#define PCI_FIELD_REPORT(struct_type, member, kind, unit_, help_)                                  \
    {                                                                                              \
        .name = #member, .type = PC_FIELD_##kind, .offset = offsetof(struct_type, member),         \
        .unit = (unit_), .help = (help_)                                                           \
    }
#define PCI_FIELD_WARNING(struct_type, member, kind, help_, warning_)                              \
    {                                                                                              \
        .name = #member, .type = PC_FIELD_##kind, .offset = offsetof(struct_type, member),         \
        .unit = "", .help = (help_), .warning = (warning_)                                         \
    }
// A record from an array of fields.
#define PCI_RECORD(fields_, struct_type)                                                           \
    {                                                                                              \
        .fields = (fields_), .field_count = sizeof(fields_) / sizeof((fields_)[0]),                \
        .size = sizeof(struct_type)                                                                \
    }

#endif
