/// Status codes, context, allocator and callbacks: what every call of the library shares.
///
/// A `pc_context` carries the allocator, the number of threads, the callbacks and the text of the
/// last error. The library keeps no global state: two contexts never influence each other. One
/// context is used by one thread at a time. Nothing is printed, and bad data never ends the
/// process.
#ifndef PROXYCLOTH_BASE_H
#define PROXYCLOTH_BASE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "proxycloth/version.h"

#ifdef __cplusplus
extern "C" {
#endif

#if defined(__GNUC__)
#define PC_NODISCARD __attribute__((warn_unused_result))
#else
#define PC_NODISCARD
#endif

/// No vertex, triangle or other element.
#define PC_INVALID_INDEX UINT32_MAX

/// One row per status: name, pinned value, meaning.
#define PC_STATUS_LIST(X)                                                                          \
    X(OK, 0, "success")                                                                            \
    X(ERROR_INVALID_ARGUMENT, 1, "the caller broke the call's contract")                           \
    X(ERROR_INVALID_OPTIONS, 2, "an option is out of its range")                                   \
    X(ERROR_INVALID_MESH, 3, "the mesh cannot be processed")                                       \
    X(ERROR_TOO_LARGE, 5, "a count exceeds a limit")                                               \
    X(ERROR_OUT_OF_MEMORY, 6, "memory ran out")                                                    \
    X(ERROR_IO, 7, "a file cannot be read or written")                                             \
    X(ERROR_FORMAT, 8, "a file is of another kind, damaged or newer")                              \
    X(ERROR_NUMERICAL, 9, "a computation left the range of finite numbers")                        \
    X(ERROR_NO_PROXY, 10, "the input leads to no proxy mesh")                                      \
    X(ERROR_CANCELLED, 11, "the progress callback cancelled the call")                             \
    X(ERROR_DEPENDENCY, 12, "a third-party library failed")                                        \
    X(ERROR_INTERNAL, 13, "an invariant of the library does not hold")                             \
    X(ERROR_VERSION, 14, "the headers are of another version than the library")

#define PC_STATUS_ENUMERATOR(name, value, text) PC_##name = (value),
/// What a call came to. Values are never renumbered.
typedef enum pc_status { PC_STATUS_LIST(PC_STATUS_ENUMERATOR) } pc_status;
#undef PC_STATUS_ENUMERATOR

/// The meaning of a status in a few words; "unknown status" for any other value. Never NULL.
const char *pc_status_text(pc_status status);

/// Version of the library as "major.minor.patch".
const char *pc_version(void);

/// A third-party library that calls of this one lead into.
typedef struct pc_dependency {
    const char *name;
    char version[32]; ///< of the library that is loaded, or of its headers where it does not tell
    const char *licence; ///< SPDX expression
} pc_dependency;

/// Fills `dependency` with the library of that number, counted from 0; false when there is none.
bool pc_dependency_at(size_t index, pc_dependency *dependency);

/// The state that calls share; see pc_context_create.
typedef struct pc_context pc_context;

/// Where memory comes from. `allocate` may return NULL, which ends the call with
/// PC_ERROR_OUT_OF_MEMORY. Both functions must be callable from several threads.
/// Embree, HDF5, libpng and SuiteSparse keep allocating from the C library.
/// With the C library's own allocator, a stage ends with malloc_trim where glibc keeps more than
/// 128 MiB of released memory.
typedef struct pc_allocator {
    void *(*allocate)(void *user, size_t size);
    void (*release)(void *user, void *memory);
    void *user;
} pc_allocator;

typedef enum pc_log_level { PC_LOG_WARNING = 0, PC_LOG_INFO = 1 } pc_log_level;

/// How a context is made. Zero-initialised: C allocator, all cores, silent.
typedef struct pc_context_options {
    pc_allocator allocator;
    /// Threads used inside a call. [Limit: 0..256] [Default: 0 = one per core]
    uint32_t threads;
    /// Called with short messages, for example that fewer threads could be started than asked for,
    /// from the thread that made the call. May be NULL.
    void (*log)(void *user, pc_log_level level, const char *stage, const char *message);
    /// Called several times a second with the fraction (0..1) of the running stage, from the
    /// thread that made the call. Returning false ends the call with PC_ERROR_CANCELLED. May be
    /// NULL.
    bool (*progress)(void *user, const char *stage, double fraction);
    /// Passed to both callbacks.
    void *user;
} pc_context_options;

/// What went wrong last.
typedef struct pc_error {
    pc_status status;
    /// Name of the stage or module, for example "label".
    const char *stage;
    /// One sentence with the offending name, value and limit.
    char message[512];
} pc_error;

/// Makes a context, for callers of the version `abi` of these headers: what pc_context_create
/// calls, and what other languages call with the PC_ABI_VERSION they were written for.
/// @return as pc_context_create.
PC_NODISCARD pc_status pc_context_create_abi(uint32_t abi, const pc_context_options *options,
                                             pc_context **context);

/// Makes a context. No other call is of use without one, so headers and a library that do not fit
/// each other are noticed here.
/// @param[in]  options  NULL for the defaults.
/// @param[out] context  the new context; NULL on failure.
/// @return PC_OK; PC_ERROR_VERSION; PC_ERROR_INVALID_ARGUMENT (threads above 256, half an
///         allocator); PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD static inline pc_status pc_context_create(const pc_context_options *options,
                                                       pc_context **context) {
    return pc_context_create_abi(PC_ABI_VERSION, options, context);
}

/// Destroys a context. NULL is accepted.
void pc_context_destroy(pc_context *context);

/// The last error of this context; status PC_OK and an empty message before the first one.
const pc_error *pc_context_error(const pc_context *context);

/// The number of threads that calls with this context use.
uint32_t pc_context_threads(const pc_context *context);

/// Releases memory that the library handed out with this context. NULL is accepted.
void pc_release(pc_context *context, void *memory);

#ifdef __cplusplus
}
#endif
#endif
