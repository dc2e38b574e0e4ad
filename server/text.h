/* Reading a request's target from left to right. What is not there is not taken: each function that
 * returns false has read an unknown part, and the caller gives up or works on a copy.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_TEXT_H
#define SERVER_TEXT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct text { /* what is left to read, borrowed */
    const char *p, *end;
};

bool text_take(struct text *t, const char *word); /* false: t is as it was */
bool text_at_end(const struct text *t);
bool text_is_digit(const struct text *t); /* of what comes next */
/* A natural number of at most 9 digits, no leading zero. */
bool text_take_uint(struct text *t, uint32_t *out);
/* [-]digits[.digits] times 10^scale, rounded half away from zero: at most 9 digits before the point
 * and 12 after. "-0" is 0. */
bool text_take_fixed(struct text *t, int scale, int64_t *out);
/* The rest of t, percent-decoded ('+' is a space, as forms write it). False: no text, too long, a
 * broken escape, a control character, or no UTF-8. */
bool text_take_decoded(struct text *t, char *out, size_t room);

/* Percent-encode a text as a value of a query: RFC 3986's unreserved characters stay, and ',' ':'
 * '=', which it allows there. out holds 3 bytes for each of text, and one more. */
void text_escape(const char *text, char *out);

bool text_is_utf8(const char *text);
/* No control character but tabs (RFC 9110, section 5.5). */
bool text_is_clean(const char *p, size_t n);

/* Write at p and return where it ends; there is room, and no NUL is written. For what every answer
 * of a tile says: by printf it would be a tenth of the work of an answer. */
char *text_put(char *p, const char *word);
char *text_put_uint(char *p, uint32_t v); /* in decimal, at most TEXT_UINT bytes */
enum { TEXT_UINT = 10 };

#endif
