// What the import child may ask of the system: reading files, memory, time, and its pipe.
// Everything else (network, writing, other programs, other processes) fails with EPERM.
#define _DEFAULT_SOURCE // SYS_*
#include "scene.h"

#if defined(__x86_64__)
#define ISOLATE_ARCHITECTURE AUDIT_ARCH_X86_64
#elif defined(__aarch64__)
#define ISOLATE_ARCHITECTURE AUDIT_ARCH_AARCH64
#endif

#if defined(__linux__) && defined(ISOLATE_ARCHITECTURE)

#include <errno.h>
#include <fcntl.h>
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

// Allowed whatever the arguments.
static const unsigned plain_calls[] = {
    SYS_read,           SYS_readv,         SYS_pread64,         SYS_lseek,
    SYS_close,          SYS_fstat,         SYS_newfstatat,      SYS_statx,
    SYS_faccessat,      SYS_readlinkat,    SYS_getcwd,          SYS_fcntl,
    SYS_mmap,           SYS_munmap,        SYS_mremap,          SYS_mprotect,
    SYS_madvise,        SYS_brk,           SYS_futex,           SYS_rt_sigaction,
    SYS_rt_sigprocmask, SYS_rt_sigreturn,  SYS_sigaltstack,     SYS_getpid,
    SYS_gettid,         SYS_clock_gettime, SYS_gettimeofday,    SYS_clock_nanosleep,
    SYS_sched_yield,    SYS_getrandom,     SYS_restart_syscall, SYS_exit,
    SYS_exit_group,
#if defined(__x86_64__)
    SYS_stat,           SYS_lstat,         SYS_access,          SYS_readlink,
    SYS_time,
#endif
};

// Allowed when (argument & mask) == value.
typedef struct guarded_call {
    unsigned number, argument;
    uint32_t mask, value;
} guarded_call;

enum { CAPACITY = 256, GUARDED = 4 };

typedef struct program {
    struct sock_filter code[CAPACITY];
    unsigned short length;
} program;

static void emit(program *p, unsigned code, uint32_t k, unsigned skip_if_true,
                 unsigned skip_if_false) {
    p->code[p->length++] =
        (struct sock_filter){(uint16_t)code, (uint8_t)skip_if_true, (uint8_t)skip_if_false, k};
}

static void emit_load(program *p, size_t offset) {
    emit(p, BPF_LD | BPF_W | BPF_ABS, (uint32_t)offset, 0, 0);
}

static void emit_return(program *p, uint32_t action) { emit(p, BPF_RET | BPF_K, action, 0, 0); }

bool scene_isolate(int descriptor) {
    const uint32_t writes = O_ACCMODE | O_CREAT | O_TRUNC | O_APPEND;
    const uint32_t refuse = SECCOMP_RET_ERRNO | EPERM;
    const guarded_call guarded[GUARDED] = {
        {SYS_write, 0, UINT32_MAX, (uint32_t)descriptor},
        {SYS_openat, 2, writes, O_RDONLY},
        {SYS_tgkill, 0, UINT32_MAX, (uint32_t)getpid()}, // abort()
#if defined(__x86_64__)
        {SYS_open, 1, writes, O_RDONLY},
#endif
    };
    _Static_assert(sizeof(plain_calls) / sizeof(plain_calls[0]) * 2 + GUARDED * 6 + 5 <= CAPACITY,
                   "the filter fits");
    program p = {.length = 0};
    // Calls of another architecture have other numbers; those of x32 lie above all of x86-64.
    emit_load(&p, offsetof(struct seccomp_data, arch));
    emit(&p, BPF_JMP | BPF_JEQ | BPF_K, ISOLATE_ARCHITECTURE, 1, 0);
    emit_return(&p, refuse);
    emit_load(&p, offsetof(struct seccomp_data, nr));
    for (size_t i = 0; i < sizeof(plain_calls) / sizeof(plain_calls[0]); ++i) {
        emit(&p, BPF_JMP | BPF_JEQ | BPF_K, plain_calls[i], 0, 1);
        emit_return(&p, SECCOMP_RET_ALLOW);
    }
    for (size_t i = 0; i < GUARDED && guarded[i].mask != 0; ++i) {
        emit(&p, BPF_JMP | BPF_JEQ | BPF_K, guarded[i].number, 0, 5);
        emit_load(&p, offsetof(struct seccomp_data, args) + 8 * guarded[i].argument); // low half
        emit(&p, BPF_ALU | BPF_AND | BPF_K, guarded[i].mask, 0, 0);
        emit(&p, BPF_JMP | BPF_JEQ | BPF_K, guarded[i].value, 0, 1);
        emit_return(&p, SECCOMP_RET_ALLOW);
        emit_return(&p, refuse);
    }
    emit_return(&p, refuse);
    const struct sock_fprog filter = {.len = p.length, .filter = p.code};
    return prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0 &&
           prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &filter) == 0;
}

#else

bool scene_isolate(int descriptor) {
    (void)descriptor;
    return false;
}

#endif
