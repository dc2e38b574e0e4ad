/* Typed parameters of paths and queries: the rows of params.def.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PARAM_H
#define SERVER_PARAM_H

#include "server/target.h"
#include "server/text.h"

enum { PARAM_PATH = 1 << 16 }; /* beside the groups of route.h: it stands in a path */
enum param_type {
    PARAM_NAME,    /* [a-z0-9][a-z0-9_-]* of so many letters */
    PARAM_NATURAL, /* a natural number; the range is checked later, by who knows more */
    PARAM_COUNT,   /* a natural number in the range */
    PARAM_E7,      /* a decimal number in the range, kept in 1e-7 */
    PARAM_E3,      /* the same in thousandths */
    PARAM_ANGLE,   /* the same, kept in 0 to 359999 */
    PARAM_FORMAT,  /* an extension (format.h), the last of its text */
    PARAM_WORD,    /* one of the words: the first is kept as `least`, the next as one more */
    PARAM_TEXT,    /* percent-encoded UTF-8 */
    PARAM_REST,    /* whatever follows; it is not kept */
    PARAM_OWN,     /* its own function reads it */
};
struct param {
    const char *name;
    unsigned groups;
    enum param_type type;
    enum err_code (*read)(struct text *t, struct target *out, struct err *e); /* of PARAM_OWN */
    double least, most;
    const char *words;    /* "a|b|c"; of PARAM_OWN a pattern; may be NULL */
    const char *standard; /* NULL: nothing is set where it is left out */
    size_t at, size;      /* of its member in struct target */
    const char *must, *about;
};
extern const struct param PARAMS[];
extern const size_t PARAMS_COUNT;

/* Read one value from t on, in a query to its end. ERR_NOENT: it is none, and e is not set.
 * ERR_DATA, ERR_FORMAT: it is one that cannot be, and e says why. */
enum err_code param_read(const struct param *p, struct text *t, struct target *out,
                         struct err *e) ERR_USE;
/* May an appearance be kept under it? [a-z0-9][a-z0-9_-]*, and none of the words that have a
 * meaning. */
bool param_is_kept_name(const char *name);

#endif
