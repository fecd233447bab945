// validatorUrl must be null: by default Swagger UI sends the document's address to a validator elsewhere.
SwaggerUIBundle({
  url: "/openapi.json",
  dom_id: "#console",
  validatorUrl: null,
  deepLinking: true,
  tryItOutEnabled: true,
  displayRequestDuration: true,
  docExpansion: "list",
  defaultModelsExpandDepth: 0,
});
