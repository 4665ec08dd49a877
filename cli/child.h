// Child processes with limits: the importer, and the garments of a batch.
#ifndef CHILD_H
#define CHILD_H

#include <stdint.h>
#include <sys/types.h>

// Forks, as fork() does. The child is a group of its own, takes signals as any program does, leaves
// no core file, and is killed when this process ends.
pid_t child_fork(void);

// In the child: limits of itself and its children.
void child_limit(int resource, double amount);
void child_limit_seconds(double cpu_seconds);
void child_limit_memory(int resource, uint32_t mebibytes);

#endif
