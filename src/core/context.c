#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/clock.h"
#include "core/context.h"
#include "core/embree.h"
#include "proxycloth/version.h"

#define PCI_STATUS_TEXT(name, value, text)                                                         \
    case PC_##name:                                                                                \
        return text;

const char *pc_status_text(pc_status status) {
    switch (status) { PC_STATUS_LIST(PCI_STATUS_TEXT) }
    return "unknown status";
}

const char *pc_version(void) { return PC_VERSION_STRING; }

void *pci_default_allocate(void *user, size_t size) {
    (void)user;
    return malloc(size);
}

static void default_release(void *user, void *memory) {
    (void)user;
    free(memory);
}

pc_status pc_context_create_abi(uint32_t abi, const pc_context_options *options,
                                pc_context **context) {
    if (context == NULL) {
        return PC_ERROR_INVALID_ARGUMENT;
    }
    *context = NULL;
    if (abi != PC_ABI_VERSION) {
        return PC_ERROR_VERSION;
    }
    pc_context_options chosen = {0};
    if (options != NULL) {
        chosen = *options;
    }
    if (chosen.threads > 256 ||
        (chosen.allocator.allocate == NULL) != (chosen.allocator.release == NULL)) {
        return PC_ERROR_INVALID_ARGUMENT;
    }
    if (chosen.allocator.allocate == NULL) {
        chosen.allocator.allocate = pci_default_allocate;
        chosen.allocator.release = default_release;
    }
    pc_context *created = chosen.allocator.allocate(chosen.allocator.user, sizeof(*created));
    if (created == NULL) {
        return PC_ERROR_OUT_OF_MEMORY;
    }
    memset(created, 0, sizeof(*created));
    created->options = chosen;
    created->error.stage = created->stage = "";
    created->pool = pci_pool_create(created, chosen.threads);
    if (created->pool == NULL) {
        chosen.allocator.release(chosen.allocator.user, created);
        return PC_ERROR_OUT_OF_MEMORY;
    }
    *context = created;
    return PC_OK;
}

void pc_context_destroy(pc_context *context) {
    if (context == NULL) {
        return;
    }
    pci_embree_release(context->embree);
    pci_pool_destroy(context, context->pool);
    const pc_allocator allocator = context->options.allocator;
    allocator.release(allocator.user, context);
}

const pc_error *pc_context_error(const pc_context *context) { return &context->error; }

uint32_t pc_context_threads(const pc_context *context) { return pci_pool_threads(context->pool); }

pc_status(pci_fail)(pc_context *context, pc_status status, const char *stage, const char *format,
                    ...) {
    context->error.status = status;
    context->error.stage = stage;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(context->error.message, sizeof(context->error.message), format, arguments);
    va_end(arguments);
    return status;
}

pc_status(pci_fail_memory)(pc_context *context, const char *stage) {
    return context->cancelled
               ? pci_fail_cancelled(context, stage)
               : pci_fail(context, PC_ERROR_OUT_OF_MEMORY, stage, "%s: memory ran out", stage);
}

pc_status(pci_fail_cancelled)(pc_context *context, const char *stage) {
    context->cancelled = false;
    return pci_fail(context, PC_ERROR_CANCELLED, stage, "%s: cancelled", stage);
}

void pci_log(pc_context *context, pc_log_level level, const char *stage, const char *format, ...) {
    if (context->options.log == NULL) {
        return;
    }
    char message[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(message, sizeof(message), format, arguments);
    va_end(arguments);
    context->options.log(context->options.user, level, stage, message);
}

bool pci_progress(pc_context *context, const char *stage, double fraction) {
    if (context->options.progress == NULL) {
        return true;
    }
    context->stage = stage;
    context->fraction = fraction;
    context->reported = pci_clock_seconds();
    context->cancelled = !context->options.progress(context->options.user, stage, fraction);
    return !context->cancelled;
}

bool pci_keep_going(pc_context *context) {
    static const double interval = 0.1;
    if (context->options.progress == NULL || pci_clock_seconds() - context->reported < interval) {
        return true;
    }
    return pci_progress(context, context->stage, context->fraction);
}

pc_status pci_begin_stage(pc_context *context, const char *stage, const pc_record *record,
                          const void *given, void *chosen) {
    context->stage = stage;
    context->fraction = 0.0;
    context->reported = pci_clock_seconds();
    context->cancelled = false;
    if (given != NULL) {
        memcpy(chosen, given, record->size);
    } else {
        pc_record_set_defaults(record, chosen);
    }
    return pc_record_check(context, stage, record, chosen);
}
