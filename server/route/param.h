/* Typed parameters of paths and queries: the rows of params.def.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PARAM_H
#define SERVER_PARAM_H

#include "server/base/text.h"
#include "server/route/target.h"

/* with bits of groups: the parameter is part of a path */
enum { PARAM_PATH = 1 << TARGET_GROUPS };
enum param_type {
    PARAM_NAME,    /* [a-z0-9][a-z0-9_-]*, with a length in the range */
    PARAM_NATURAL, /* a natural number; its range is checked later */
    PARAM_COUNT,   /* a natural number in the range */
    PARAM_E7,      /* a decimal number in the range, stored in 1e-7 */
    PARAM_E3,      /* the same, in thousandths */
    PARAM_ANGLE,   /* the same, stored as 0 to 359999 */
    PARAM_FORMAT,  /* an extension (format.h) at the end of the text */
    PARAM_WORD,    /* one of the words: the first is stored as `least`, the next as one more */
    PARAM_TEXT,    /* percent-encoded UTF-8 */
    PARAM_SPAN,    /* any text up to a slash of the path, at least `least` bytes; borrowed */
    PARAM_REST,    /* any text; it is not stored */
    PARAM_OWN,     /* a function of its own reads it */
};
struct param {
    enum param_type type;
    /* for PARAM_OWN; group: its struct target_GROUP */
    enum err_code (*read)(struct text *t, void *group, struct err *e);
    const char *name;
    unsigned in; /* bits of groups, as route.takes, and PARAM_PATH */
    double least, most;
    const char *words;    /* "a|b|c"; for PARAM_SPAN and PARAM_OWN a pattern; may be NULL */
    const char *standard; /* default; NULL: nothing is set */
    enum target_group group;
    size_t at, size; /* of its member in the group's struct */
    const char *must, *about;
};
extern const struct param PARAMS[];
extern const size_t PARAMS_COUNT;

/* Reads one value from t on; in a query it must end there. out->route takes its group. ERR_NOENT:
 * there is no such value; e is not set. ERR_DATA, ERR_FORMAT: the value is impossible; e says why.
 */
enum err_code param_read(const struct param *p, struct text *t, struct target *out,
                         struct err *e) ERR_USE;
/* The i-th choice [n] of a format or word. NULL: there are no more. */
const char *param_choice(const struct param *p, uint32_t i, size_t *n);
/* Returns whether an appearance may have this name: [a-z0-9][a-z0-9_-]*, and no word with another
 * meaning. */
bool param_is_kept_name(const char *name);
/* Parses text [n] as a background: RRGGBB, "sky" or "transparent". Returns false for any other. */
bool param_read_background(const char *text, size_t n, struct composite *out);

#endif
