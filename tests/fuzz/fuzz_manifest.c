// Manifests of `batch`.
#include "../../cli/batch.h"
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static cli_command command;
    static cli_arguments arguments;
    fuzz_be_silent();
    if (command.name == NULL) {
        char *words[] = {(char[]){"x.obj"}, (char[]){"-o"}, (char[]){"out"}};
        fuzz_assert(cli_find_command("batch", &command));
        fuzz_assert(cli_parse(&command, 3, words, &arguments) == CLI_OK);
    }
    batch_plan plan = {.command = &command, .arguments = &arguments};
    (void)batch_read_manifest(&plan, fuzz_file(data, size));
    batch_plan_free(&plan);
    return 0;
}
