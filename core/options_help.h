/* How the options of a command are shown: as the text of --help, as Markdown for docs/commands.md,
 * as a manual page (mdoc), as a part of a shell's completion. All come from the same table.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_OPTIONS_HELP_H
#define CORE_OPTIONS_HELP_H

#include <stdio.h>

#include "core/options_spec.h"

enum { OPTIONS_NAME_MAX = 64 };

enum options_format {
    OPTIONS_FORMAT_TEXT, /* the everyday options, and how many more there are by heading */
    OPTIONS_FORMAT_ALL,  /* text of all options */
    OPTIONS_FORMAT_MARKDOWN,
    OPTIONS_FORMAT_MDOC,
    OPTIONS_FORMAT_BASH, /* this and the next two: core/options_completion.h */
    OPTIONS_FORMAT_ZSH,
    OPTIONS_FORMAT_FISH
};

/* The name of a key's flag without its dashes: cell_edge_m -> cell-edge-m. */
void options_help_flag(const char *key, char out[OPTIONS_NAME_MAX]);

/* The flag that changes the default: no-masks where masks are on. */
void options_help_shown_flag(const struct options_def *d, char out[OPTIONS_NAME_MAX + 4]);

/* Everything about a command on `f`: usage, what it does, its options by group, examples. The
 * text leaves out the options that are not everyday ones, unless the format is ALL. The Markdown is
 * a section ("## citysplat train") of a page; the mdoc is what stands behind
 * options_help_mdoc_head(). */
void options_help_print(FILE *f, const struct options_spec *spec, enum options_format format);

/* One paragraph of mdoc: nothing in `text` is read as a request. */
void options_help_mdoc_text(FILE *f, const char *text);
/* The first lines of a manual page, up to what it is about; `page` is "citysplat-train". */
void options_help_mdoc_head(FILE *f, const char *page, const char *about);

#endif
