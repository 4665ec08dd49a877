#define _DEFAULT_SOURCE // setrlimit
#include "child.h"

#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

// AddressSanitizer and ThreadSanitizer reserve terabytes of addresses: no limit on them then.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define LIMIT_MEMORY 0
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define LIMIT_MEMORY 0
#endif
#endif
#ifndef LIMIT_MEMORY
#define LIMIT_MEMORY 1
#endif

static void set_limits(int resource, double soft, double hard) {
    const struct rlimit both = {.rlim_cur = (rlim_t)soft, .rlim_max = (rlim_t)hard};
    (void)setrlimit((__rlimit_resource_t)resource, &both);
}

void child_limit(int resource, double amount) { set_limits(resource, amount, amount); }

pid_t child_fork(void) {
    static const int signals[] = {SIGINT, SIGTERM, SIGHUP, SIGPIPE};
    const pid_t parent = getpid();
    fflush(NULL);
    const pid_t child = fork();
    if (child != 0) {
        // The group is made on both sides so that it exists whoever runs first.
        if (child > 0) {
            (void)setpgid(child, child);
        }
        return child;
    }
    (void)setpgid(0, 0);
    (void)prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (getppid() != parent) {
        _exit(1);
    }
    for (size_t i = 0; i < sizeof(signals) / sizeof(signals[0]); ++i) {
        signal(signals[i], SIG_DFL);
    }
    sigset_t none;
    sigemptyset(&none);
    (void)sigprocmask(SIG_SETMASK, &none, NULL);
    child_limit(RLIMIT_CORE, 0.0);
    return 0;
}

void child_limit_seconds(double cpu_seconds) {
    // At the soft limit comes SIGXCPU, which tells the reason; at the hard one SIGKILL.
    set_limits(RLIMIT_CPU, ceil(cpu_seconds), ceil(cpu_seconds) + 1.0);
}

void child_limit_memory(int resource, uint32_t mebibytes) {
    if (LIMIT_MEMORY) {
        child_limit(resource, (double)mebibytes * 1048576.0);
    }
}
