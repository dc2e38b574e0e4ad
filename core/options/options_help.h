/* Shows the options of a command: as text of --help, as Markdown for docs/commands.md, as a manual
 * page (mdoc), or as part of shell completion. All come from the same table.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_OPTIONS_HELP_H
#define CORE_OPTIONS_HELP_H

#include <stdio.h>

#include "core/options/options_spec.h"

enum { OPTIONS_NAME_MAX = 64 };

enum options_format {
    OPTIONS_FORMAT_TEXT, /* everyday options, and under each heading the number of others */
    OPTIONS_FORMAT_ALL,  /* text of all options */
    OPTIONS_FORMAT_MARKDOWN,
    OPTIONS_FORMAT_MDOC,
    OPTIONS_FORMAT_BASH, /* this and the next two: see core/options/options_completion.h */
    OPTIONS_FORMAT_ZSH,
    OPTIONS_FORMAT_FISH
};

/* The flag of a key, without dashes: cell_edge_m -> cell-edge-m. */
void options_help_flag(const char *key, char out[OPTIONS_NAME_MAX]);

/* The flag that changes the default: no-masks if masks are on by default. */
void options_help_shown_flag(const struct options_def *d, char out[OPTIONS_NAME_MAX + 4]);

/* Writes usage, description, options by group and examples of a command to `f`. TEXT leaves out
 * options that are not everyday ones; ALL has them. MARKDOWN is a section of a page ("## citysplat
 * train"). MDOC is what follows options_help_mdoc_head(). */
void options_help_print(FILE *f, const struct options_spec *spec, enum options_format format);

/* Writes one paragraph of mdoc. `text` is escaped, so none of it is read as a request. */
void options_help_mdoc_text(FILE *f, const char *text);
/* Writes the first lines of a manual page. `page` is "citysplat-train", `about` its one-line
 * description. */
void options_help_mdoc_head(FILE *f, const char *page, const char *about);

#endif
