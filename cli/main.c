#include <stdio.h>

#include "proxycloth/proxycloth.h"

int main(void) {
    printf("proxycloth %s\n", pc_version());
    return 0;
}
