#include "support/test.h"

static void waits_to_be_written(void **state) {
    (void)state;
    skip();
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(waits_to_be_written),
    };
    return cmocka_run_group_tests_name("carve", tests, NULL, NULL);
}
