#include "core/sparse.h"

pc_status pci_cholesky_create(pc_context *context, const char *stage, size_t size,
                              const size_t *column_offsets, const uint32_t *rows,
                              const double *values, pci_cholesky **cholesky) {
    (void)size;
    (void)column_offsets;
    (void)rows;
    (void)values;
    *cholesky = NULL;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, stage, "%s: not written yet", stage);
}
pc_status pci_cholesky_solve(pc_context *context, const pci_cholesky *cholesky, size_t columns,
                             const double *b, double *x) {
    (void)cholesky;
    (void)columns;
    (void)b;
    (void)x;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "sparse", "sparse: not written yet");
}
void pci_cholesky_destroy(pc_context *context, pci_cholesky *cholesky) {
    (void)context;
    (void)cholesky;
}
