// Options as JSON: what is read is in range, and a failure changes nothing.
#include <string.h>

#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pc_context *context = fuzz_context();
    pc_options options = pc_default_options();
    const pc_options before = options;
    pc_option_group groups[PC_STAGE_COUNT];
    pc_option_groups(&options, groups);
    pc_series series = {.name = "vertices"};
    groups[PC_STAGE_SIMPLIFY].series = &series;
    if (pc_options_parse(context, (const char *)data, size, "fuzz.json", groups, PC_STAGE_COUNT) !=
        PC_OK) {
        fuzz_assert(memcmp(&before, &options, sizeof(options)) == 0 && series.count == 0);
        return 0;
    }
    for (size_t i = 0; i < PC_STAGE_COUNT; ++i) {
        fuzz_assert(pc_record_check(context, "fuzz", groups[i].record, groups[i].values) == PC_OK);
    }
    return 0;
}
