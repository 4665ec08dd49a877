#define _GNU_SOURCE // sched_getaffinity
#include <pthread.h>
#include <sched.h>
#include <unistd.h>

#include "core/context.h"
#include "core/embree.h"

enum { LOOKS = 4000 }; // before a thread that waits leaves its core to others, some 50 us

// One job at a time: workers wait until `generation` changes, then join and take pieces from
// `next_piece`. Who wakes when the pieces are gone is not waited for. All look for a while before
// they sleep: jobs follow one another closely, and waking takes longer than the shortest of them.
struct pci_pool {
    uint32_t thread_count; // including the caller
    uint32_t started;
    uint32_t looks; // LOOKS, or 0 where there are more threads than cores
    pthread_mutex_t mutex;
    pthread_cond_t wake;
    pthread_cond_t done;
    atomic_uint_fast64_t generation;
    atomic_uint joined;
    bool open, quit; // whether there is a job to join
    size_t count, grain;
    pci_parallel_body body;
    void *user;
    atomic_size_t next_piece;
    struct pci_worker {
        pci_pool *pool;
        uint32_t index;
        pthread_t thread;
    } * workers;
};

static inline void pause_core(void) {
#if defined(__x86_64__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    __asm__ volatile("yield");
#endif
}

// `asked`: the context whose user may cancel, only on the thread that entered the library. Returns
// whether nobody cancelled.
static bool run_pieces(pci_pool *pool, uint32_t worker, pc_context *asked) {
    const size_t pieces = (pool->count + pool->grain - 1) / pool->grain;
    for (;;) {
        const size_t piece = atomic_fetch_add(&pool->next_piece, 1);
        if (piece >= pieces) {
            return true;
        }
        const size_t begin = piece * pool->grain;
        const size_t end = pool->count - begin < pool->grain ? pool->count : begin + pool->grain;
        pool->body(pool->user, begin, end, worker);
        if (asked != NULL && !pci_keep_going(asked)) {
            atomic_store(&pool->next_piece, pieces);
            return false;
        }
    }
}

static void *worker_main(void *argument) {
    struct pci_worker *worker = argument;
    pci_pool *pool = worker->pool;
    uint64_t seen = 0;
    pthread_mutex_lock(&pool->mutex);
    for (;;) {
        pthread_mutex_unlock(&pool->mutex);
        for (uint32_t look = 0; look < pool->looks && pool->generation == seen; ++look) {
            pause_core();
        }
        pthread_mutex_lock(&pool->mutex);
        while (!pool->quit && !(pool->open && pool->generation != seen)) {
            pthread_cond_wait(&pool->wake, &pool->mutex);
        }
        if (pool->quit) {
            break;
        }
        seen = pool->generation;
        ++pool->joined;
        pthread_mutex_unlock(&pool->mutex);
        (void)run_pieces(pool, worker->index, NULL);
        pthread_mutex_lock(&pool->mutex);
        if (--pool->joined == 0) {
            pthread_cond_signal(&pool->done);
        }
    }
    pthread_mutex_unlock(&pool->mutex);
    return NULL;
}

// Cores that this process may use: a farm's scheduler gives it some of the machine's.
static uint32_t count_cores(void) {
    long cores = sysconf(_SC_NPROCESSORS_ONLN);
#ifdef __linux__
    cpu_set_t allowed; // holds 1024 cores; on larger machines the call fails
    if (sched_getaffinity(0, sizeof(allowed), &allowed) == 0) {
        cores = CPU_COUNT(&allowed);
    }
#endif
    return cores < 1 ? 1 : cores > 256 ? 256 : (uint32_t)cores;
}

pci_pool *pci_pool_create(pc_context *context, uint32_t threads) {
    const uint32_t cores = count_cores();
    if (threads == 0) {
        threads = cores;
    }
    pci_pool *pool = PCI_ALLOCATE(context, pci_pool, 1);
    if (pool == NULL) {
        return NULL;
    }
    pool->workers = PCI_ALLOCATE(context, struct pci_worker, threads);
    if (pool->workers == NULL) {
        pc_release(context, pool);
        return NULL;
    }
    pool->looks = threads <= cores ? LOOKS : 0;
    pthread_mutex_init(&pool->mutex, NULL);
    pthread_cond_init(&pool->wake, NULL);
    pthread_cond_init(&pool->done, NULL);
    for (uint32_t i = 0; i + 1 < threads; ++i) {
        struct pci_worker *worker = &pool->workers[i];
        worker->pool = pool;
        worker->index = i + 1;
        if (pthread_create(&worker->thread, NULL, worker_main, worker) != 0) {
            break;
        }
        ++pool->started;
    }
    pool->thread_count = pool->started + 1;
    if (pool->thread_count < threads) {
        pci_log(context, PC_LOG_WARNING, "context",
                "context: only %u of %u threads could be started", pool->thread_count, threads);
    }
    return pool;
}

void pci_pool_destroy(pc_context *context, pci_pool *pool) {
    pthread_mutex_lock(&pool->mutex);
    pool->quit = true;
    pthread_cond_broadcast(&pool->wake);
    pthread_mutex_unlock(&pool->mutex);
    for (uint32_t i = 0; i < pool->started; ++i) {
        pthread_join(pool->workers[i].thread, NULL);
    }
    pthread_cond_destroy(&pool->done);
    pthread_cond_destroy(&pool->wake);
    pthread_mutex_destroy(&pool->mutex);
    pc_release(context, pool->workers);
    pc_release(context, pool);
}

uint32_t pci_pool_threads(const pci_pool *pool) { return pool->thread_count; }

static bool run_loop(pc_context *context, size_t count, size_t grain, pci_parallel_body body,
                     void *user, pc_context *asked) {
    if (count == 0) {
        return true;
    }
    pci_pool *pool = context->pool;
    pool->count = count;
    pool->grain = grain == 0 ? 1 : grain;
    pool->body = body;
    pool->user = user;
    atomic_store(&pool->next_piece, 0);
    if (pool->started == 0 || count <= pool->grain) {
        return run_pieces(pool, 0, asked);
    }
    pthread_mutex_lock(&pool->mutex);
    pool->open = true;
    ++pool->generation;
    pthread_cond_broadcast(&pool->wake);
    pthread_mutex_unlock(&pool->mutex);
    const bool wanted = run_pieces(pool, 0, asked);
    pthread_mutex_lock(&pool->mutex);
    pool->open = false;
    pthread_mutex_unlock(&pool->mutex);
    for (uint32_t look = 0; look < pool->looks && pool->joined != 0; ++look) {
        pause_core();
    }
    pthread_mutex_lock(&pool->mutex);
    while (pool->joined != 0) {
        pthread_cond_wait(&pool->done, &pool->mutex);
    }
    pthread_mutex_unlock(&pool->mutex);
    return wanted;
}

void pci_parallel_for(pc_context *context, size_t count, size_t grain, pci_parallel_body body,
                      void *user) {
    (void)run_loop(context, count, grain, body, user, NULL);
}

void pci_parallel_wait(pc_context *context, const atomic_uint *count, uint32_t least) {
    for (uint32_t look = 0; atomic_load_explicit(count, memory_order_acquire) < least; ++look) {
        if (look < context->pool->looks) {
            pause_core();
        } else {
            sched_yield();
        }
    }
}

bool pci_parallel_while_wanted(pc_context *context, size_t count, size_t grain,
                               pci_parallel_body body, void *user) {
    return run_loop(context, count, grain, body, user, context);
}

// ---- tasks --------------------------------------------------------------------------------------

typedef struct task_job {
    pc_context *context;
    pc_context own; // how the contexts of the tasks begin
    pci_task task;
    void *user;
    atomic_bool cancelled;
    pthread_mutex_t mutex; // of what follows
    atomic_size_t failed;  // first task that failed, or their number
    pc_error error;        // of that one
} task_job;

typedef struct asker {
    task_job *job;
    bool may_ask; // on the thread that entered the library
} asker;

static bool report_task(void *user, const char *stage, double fraction) {
    const asker *a = user;
    if (a->may_ask && !pci_progress(a->job->context, stage, fraction)) {
        atomic_store(&a->job->cancelled, true);
    }
    return !atomic_load(&a->job->cancelled);
}

static void run_task(void *user, size_t begin, size_t end, uint32_t worker) {
    task_job *job = user;
    (void)end; // one at a time
    asker asks = {job, worker == 0};
    pci_pool alone = {.thread_count = 1};
    pc_context own = job->own;
    own.pool = &alone;
    own.options.user = &asks;
    if (begin < atomic_load(&job->failed) && job->task(job->user, begin, &own) != PC_OK) {
        pthread_mutex_lock(&job->mutex);
        if (begin < atomic_load(&job->failed)) {
            atomic_store(&job->failed, begin);
            job->error = own.error;
        }
        pthread_mutex_unlock(&job->mutex);
    }
    pci_embree_release(own.embree);
}

pc_status pci_run_tasks(pc_context *context, size_t count, pci_task task, void *user) {
    const uint32_t threads = pc_context_threads(context);
    pc_status status = PC_OK;
    if (threads == 1 || threads > 2 * count || count == 1) {
        for (size_t i = 0; i < count && status == PC_OK; ++i) {
            status = task(user, i, context);
        }
        return status;
    }
    task_job job = {.context = context, .task = task, .user = user, .failed = count};
    job.own = (pc_context){.options.allocator = context->options.allocator,
                           .stage = context->stage,
                           .fraction = context->fraction,
                           .reported = context->reported};
    job.own.options.progress = context->options.progress != NULL ? report_task : NULL;
    pthread_mutex_init(&job.mutex, NULL);
    pci_parallel_for(context, count, 1, run_task, &job);
    pthread_mutex_destroy(&job.mutex);
    if (job.failed < count) {
        context->cancelled = false;
        context->error = job.error;
        status = job.error.status;
    }
    return status;
}
