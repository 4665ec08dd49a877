// The HTML page that `report` fills; made from page.html when the program is built.
#ifndef PAGE_H
#define PAGE_H

#include "cli.h"

extern const char cli_page[];

#endif
