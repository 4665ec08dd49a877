#include "proxycloth/evaluate.h"

#include "core/core.h"

const pc_record pc_measures_record = {0};

pc_status pc_evaluate(pc_context *context, const pc_mesh *visual, const pc_mesh *proxy,
                      pc_measures *measures) {
    (void)visual;
    (void)proxy;
    (void)measures;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "evaluate", "evaluate: not written yet");
}
