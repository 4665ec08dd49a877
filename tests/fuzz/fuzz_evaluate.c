// Measures of any mesh against any other.
#include "soup.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pc_context *context = fuzz_context();
    soup_bytes bytes = {data, size};
    pc_mesh visual = soup_any(&bytes), proxy = soup_any(&bytes);
    pc_measures measures;
    if (soup_succeeds(pc_evaluate(context, &visual, &proxy, &measures))) {
        fuzz_assert(measures.edge_ratio_mean >= 0.0 && measures.edge_ratio_mean <= 1.0);
    }
    soup_free(&visual);
    soup_free(&proxy);
    return 0;
}
