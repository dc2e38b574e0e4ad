/* Errors are values. Every fallible function returns an err_code and takes a struct err last.
 *
 * The code is for programs, the message is for people. A message says what failed, which one, why,
 * and where it helps, what to do: "what : which : why". The message is set where the cause is
 * known. Callers add context in front of it with err_add, and never replace it. Wherever a struct
 * err * is taken, NULL is allowed. An error that is returned is not logged as well. Only cli/main.c
 * calls exit().
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_ERR_H
#define CORE_ERR_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* X(name, text): names and texts stand in one list, so they always match. */
#define ERR_LIST(X)                                                                                \
    X(ERR_OK, "ok")                                                                                \
    X(ERR_ARG, "invalid argument or option")                                                       \
    X(ERR_MEM, "out of memory")                                                                    \
    X(ERR_IO, "input/output error")                                                                \
    X(ERR_NOENT, "not found")                                                                      \
    X(ERR_FORMAT, "malformed data")                                                                \
    X(ERR_LIMIT, "a limit was exceeded")                                                           \
    X(ERR_DEVICE, "OpenCL device error")                                                           \
    X(ERR_DATA, "data is valid but unusable")                                                      \
    X(ERR_CANCEL, "cancelled")                                                                     \
    X(ERR_BUSY, "busy, try again")                                                                 \
    X(ERR_INTERNAL, "internal error")

enum err_code {
#define ERR_ENUM(name, text) name,
    ERR_LIST(ERR_ENUM)
#undef ERR_ENUM
};

struct err {
    enum err_code code;
    char msg[768];
};

#define ERR_USE __attribute__((warn_unused_result))
#define ERR_PRINTF(f, a) __attribute__((format(printf, f, a)))

/* Sets code and message and replaces the old ones. Returns `code`: `return err_set(e, ERR_IO,
 * ...)`. */
enum err_code err_set(struct err *e, enum err_code code, const char *fmt, ...) ERR_PRINTF(3, 4);
/* As err_set, and appends ": " and strerror(errno). Call it before anything else changes errno. */
enum err_code err_errno(struct err *e, enum err_code code, const char *fmt, ...) ERR_PRINTF(3, 4);
/* Puts context in front of the message: "context: message". Returns e->code, or ERR_INTERNAL if e
 * is NULL. */
enum err_code err_add(struct err *e, const char *fmt, ...) ERR_PRINTF(2, 3);
/* Text of a code, for people. The string is static. */
const char *err_text(enum err_code code);

#ifdef __cplusplus
}
#endif
#endif
