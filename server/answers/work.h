/* What a job does: from a dataset to bytes. A kind of work is a struct of functions in the file of
 * the answer that it serves, with parameters that only this file knows.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_WORK_H
#define SERVER_WORK_H

#include <stddef.h>

#include "server/answers/services.h"
#include "server/drawing/draw.h"
#include "server/jobs/cost.h"

struct work;
struct response;

enum {                      /* properties of a kind, as bits */
       WORK_DRAWN = 1,      /* the process that draws makes it */
       WORK_PICTURE = 2,    /* useful only to waiting clients: see job_config.passing */
       WORK_ON_DISK = 4,    /* reading it from --cache-dir is quicker than making it */
       WORK_COMPRESSED = 8, /* gzip and Brotli are kept beside it */
       WORK_OF_STORE = 16,  /* its failures count as errors of the store */
       WORK_JUDGES = 32,    /* ERR_DATA is an answer: the question has none */
};
struct work_kind {
    const char *noun; /* "map tile": for messages */
    unsigned traits;
    size_t size; /* of its parameters */
    /* Makes the bytes, in a worker thread. ERR_MEM, and the errors of the kind. */
    enum err_code (*make)(struct services *s, const struct job *j, const struct work *w,
                          struct buf *out, struct err *e);
    /* In place of make: does what is no result with a name, and gives the body of its answer. */
    enum err_code (*act)(struct services *s, const struct work *w, struct body **out,
                         struct err *e);
    /* Upper limit of the bytes. NULL: they are few. */
    size_t (*room)(const struct work *w);
    /* Estimates the time by a formula, in ms. *variant: what is learned apart (cost.h). NULL: 2 ms.
     */
    double (*cost)(const struct work *w, unsigned *variant);
    void (*free)(void *own); /* frees what the parameters own; NULL: nothing */
    /* Writes which one it is, for the log. NULL: the noun says enough. */
    void (*tell)(const struct work *w, char *out, size_t room);
    /* Turns the result into the answer, and takes over its body. NULL: the body is the answer. */
    void (*finish)(struct job_result *result, struct response *out);
};
struct work { /* freed with work_drop */
    const struct work_kind *kind;
    struct dataset *ds; /* a reference; NULL: it is of no dataset, and the kind has `act` */
    struct hash128 id;  /* name of the result: cache key and job id */
    bool keep;          /* keep the result in the cache */
    bool may_lack;      /* ERR_NOENT is an answer, and no failure */
    bool apart;         /* one of very many results (polygons, parts): see disk_put */
    struct body *made;  /* body that is written to the disk after the waiters have it; NULL: none */
    max_align_t own[];  /* parameters of the kind */
};
/* Makes work with zeroed parameters, of dataset d or of none (NULL). NULL: out of memory. */
struct work *work_make(const struct work_kind *kind, struct dataset *d);
/* The parameters: set by who makes the work, before it is submitted, and then only read. */
void *work_own(const struct work *w);
/* Upper limit of the result's bytes: its share of memory for answers while it is made. */
enum { WORK_ROOM_HEAD = 4096 }; /* part of work_room for head and end */
size_t work_room(const struct work *w);
/* Estimates the time of work, in ms, and says what learns from it: job_config.cost. */
double work_cost(const void *work, struct cost_kind *kind);
/* Borrows a handle of the dataset's store until dataset_return. Errors of dataset_borrow. */
enum err_code work_borrow(const struct work *w, struct store **s, struct err *e) ERR_USE;
/* Has the process that draws answer a request. Errors are those of picture_make. */
enum err_code work_draw(struct services *s, const struct job *j, const struct work *w,
                        struct draw_request *q, struct buf *out, struct err *e) ERR_USE;
/* Makes the bytes in a worker thread. The result is in the cache before the job ends. ERR_MEM, and
 * the errors of the kind of work. */
enum err_code work_run(void *services, const struct job *j, void *work, size_t worker,
                       struct body **out, struct err *e) ERR_USE;
void work_drop(void *services, void *work);
bool work_passing(const void *work); /* whether it is a picture, or is not kept: see job_config */

#endif
