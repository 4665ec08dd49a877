// Comparing the results of two runs, measure by measure.
#ifndef REGRESS_H
#define REGRESS_H

#include <cjson/cJSON.h>

#include "cli.h"

enum { REGRESS_MEASURES = 19 };

// Which way a measure gets worse.
typedef enum regress_sense {
    WORSE_IF_HIGHER,
    WORSE_IF_LOWER,
    WORSE_IF_CHANGED,
    NEVER_WORSE // says nothing about quality
} regress_sense;

typedef struct regress_measure {
    const char *name;
    const char *path[3]; // keys in a garment's report
    regress_sense sense;
    double absolute, relative; // allowed: their sum, relative to the baseline
} regress_measure;

extern const regress_measure regress_measures[REGRESS_MEASURES];

// Index of a measure; REGRESS_MEASURES: there is none of that name.
size_t regress_find(const char *name, size_t length);

typedef struct regress_garment {
    char *name;
    double values[REGRESS_MEASURES]; // NaN: not there
} regress_garment;

// The garments of a folder or table, sorted by name.
typedef struct regress_results {
    regress_garment *garments;
    size_t count, capacity;
} regress_results;

// Reads the reports below a folder, or a table. Prints the message on failure.
int regress_read(const cli_command *command, const char *path, regress_results *results);
void regress_free(regress_results *results);
// Prints a table that regress_read reads.
void regress_print(const regress_results *results);

#endif
