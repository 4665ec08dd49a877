// Files that are written whole: what is there while and after they are written.
#define _POSIX_C_SOURCE 200809L
#include "io/atomic_file.h"

#include <dirent.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>

#include "io/nameless_file.h"
#include "support/files.h"
#include "support/test.h"

static char folder[64], target[64], other[64];

static int set_up(void **state) {
    (void)state;
    return test_make_folder(folder, target, "target", other, "other");
}

static int tear_down(void **state) {
    (void)state;
    return test_remove_folder(folder, target, other);
}

static size_t count_files(void) {
    DIR *listing = opendir(folder);
    assert_non_null(listing);
    size_t count = 0;
    for (const struct dirent *entry; (entry = readdir(listing)) != NULL;) {
        count += entry->d_name[0] != '.';
    }
    closedir(listing);
    return count;
}

// Writes a text to the target; ends with `status`.
static pc_status write_text(pc_context *context, const char *text, pc_status status) {
    pci_atomic_file file = {0};
    assert_int_equal(pci_atomic_begin(context, "test", target, &file), PC_OK);
    fputs(text, file.stream);
    return pci_atomic_end(&file, status);
}

static void assert_target(const char *text) {
    bytes content = read_bytes(target);
    assert_string_equal((const char *)content.data, text);
    free(content.data);
}

static void the_target_is_old_or_new(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    assert_int_equal(write_text(context, "old", PC_OK), PC_OK);
    assert_target("old");
    assert_int_equal(write_text(context, "new", PC_ERROR_CANCELLED), PC_ERROR_CANCELLED);
    assert_target("old");
    assert_int_equal(count_files(), 1);
    assert_int_equal(write_text(context, "newer", PC_OK), PC_OK);
    assert_target("newer");
    assert_int_equal(count_files(), 1);
    const mode_t mask = umask(0);
    (void)umask(mask);
    struct stat info;
    assert_int_equal(stat(target, &info), 0);
    assert_int_equal(info.st_mode & 0777, 0666 & ~mask);
    pc_context_destroy(context);
}

// A process that ends while it writes leaves nothing behind, and what others left is in nobody's
// way.
static void nothing_stays_behind(void **state) {
    (void)state;
    const int nameless = pci_nameless_open(folder);
    if (nameless < 0) {
        print_message("no files without a name here\n");
        skip();
    }
    close(nameless);
    write_bytes(target, "old", 3);
    const pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) {
        pc_context *context = test_context(1);
        pci_atomic_file file = {0};
        if (pci_atomic_begin(context, "test", target, &file) != PC_OK) {
            _exit(1);
        }
        fputs("new", file.stream);
        fflush(file.stream);
        _exit(0);
    }
    int status = 1;
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_int_equal(status, 0);
    assert_int_equal(count_files(), 1);
    assert_target("old");
    char left[96];
    snprintf(left, sizeof(left), "%s.tmp-%ld-0", target, (long)getpid());
    write_bytes(left, "left", 4);
    pc_context *context = test_context(1);
    assert_int_equal(write_text(context, "new", PC_OK), PC_OK);
    assert_target("new");
    assert_int_equal(unlink(left), 0);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(the_target_is_old_or_new, set_up, tear_down),
        cmocka_unit_test_setup_teardown(nothing_stays_behind, set_up, tear_down),
    };
    return cmocka_run_group_tests_name("atomic_file", tests, NULL, NULL);
}
