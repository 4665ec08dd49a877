// Scenarios as JSON; what is read can be written and read again.
#include <string.h>

#include "fuzz.h"
#include "io/scenario_file.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pc_context *context = fuzz_context();
    pc_options options = pc_default_options();
    pc_scenario scenario = {0}, again = {0};
    if (pc_scenario_parse(context, (const char *)data, size, "fuzz.json", &options.simulate,
                          &scenario) == PC_OK) {
        char *text = pci_scenario_text(context, &scenario);
        fuzz_assert(text != NULL && pc_scenario_check(context, &scenario) == PC_OK);
        fuzz_assert(pc_scenario_parse(context, text, strlen(text), "again.json", &options.simulate,
                                      &again) == PC_OK);
        pc_release(context, text);
    }
    pc_scenario_free(context, &scenario);
    pc_scenario_free(context, &again);
    return 0;
}
