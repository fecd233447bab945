// What a session changes needs its token beside the cookie; there is none where nobody is logged in.
const token = document.querySelector('meta[name="csrf-token"]')?.content;

function withToken(request) {
  if (token && new URL(request.url, location).origin === location.origin) {
    request.headers["X-CSRF-Token"] = token;
  }
  return request;
}

// validatorUrl must be null: by default Swagger UI sends the document's address to a validator elsewhere.
SwaggerUIBundle({
  url: "/openapi.json",
  dom_id: "#console",
  validatorUrl: null,
  requestInterceptor: withToken,
  deepLinking: true,
  tryItOutEnabled: true,
  displayRequestDuration: true,
  docExpansion: "list",
  defaultModelsExpandDepth: 0,
});
