// The parser of the command line: words end at line feeds, the first one is the command.
#include <string.h>

#include "../../cli/cli.h"
#include "fuzz.h"

enum { MAXIMUM_WORDS = 64 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    char *text = malloc(size + 1), *words[MAXIMUM_WORDS + 1];
    int count = 0;
    fuzz_be_silent();
    fuzz_assert(text != NULL);
    memcpy(text, data, size);
    text[size] = '\0';
    for (char *word = text; word != NULL && count < MAXIMUM_WORDS;) {
        char *end = strchr(word, '\n');
        words[count++] = word;
        if (end != NULL) {
            *end++ = '\0';
        }
        word = end;
    }
    words[count] = NULL;
    cli_command command;
    cli_arguments arguments = {0};
    if (cli_find_command(words[0], &command)) {
        (void)cli_parse(&command, count - 1, words + 1, &arguments);
        cli_arguments_free(&arguments);
    }
    free(text);
    return 0;
}
